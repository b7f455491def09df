"""Reads job profiles from `NAME.jobs.yaml`, beside the file that names them or among the shipped ones.

Problems are collected and raised together.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from framekit.blocks.jobs.profile import JobProfile
from framekit.blocks.jobs.profile_loader import JobProfileLoader
from framekit.definition.load.documents import Documents
from framekit.definition.load.profile_files import find_profile
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.problems import NOWHERE, DefinitionError, Position

SUFFIX = ".jobs.yaml"


def load_job_profile(name_or_path: str | Path, folder: Path | None = None, at: Position = NOWHERE) -> JobProfile:
    """The profile in a file (a Path), or of a name: `NAME.jobs.yaml` in `folder`, else a shipped one.

    `at` is where the name was written. Raises DefinitionError with everything that is wrong.
    """
    path = name_or_path
    if not isinstance(path, Path):
        path = find_profile(path, folder, at, kind="job profile", suffix=SUFFIX)
    reader = Reader()
    documents = Documents(reader)
    profile = None
    with suppress(Broken):
        profile = JobProfileLoader(reader, documents.root(path, "jobs")).profile()
    problems = documents.first_words(reader.problems, path)
    if profile is None or problems:
        raise DefinitionError(problems)
    return profile
