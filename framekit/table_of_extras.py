"""List the extras: a row for each folder of `framekit/extras`, with the verbs, generators and formats that it brings.

The core imports no extra. It looks here for a name, such as that of a verb, and imports the object when it is used.
An object is written `MODULE:NAME`, with the module below `framekit.extras`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple


class Verb(NamedTuple):
    """A verb of the command line."""

    about: str
    module: str
    """Module with `add_VERB_arguments` and `run_VERB`."""
    uses_cache: bool = True
    """Whether the verb takes definitions from the user's cache folder if it holds them."""


class Generator(NamedTuple):
    """A kind of text that `framekit generate` writes."""

    about: str
    target: str
    """Function that takes the arguments of the verb and returns the exit status."""


class Importer(NamedTuple):
    """A format of files that `framekit import` makes definitions of."""

    about: str
    encoding: str
    """Encoding of its files; a file with invalid bytes is refused."""
    target: str
    """Function that takes text, name of the file and name of the protocol, and returns an `ImportedDefinition`."""


class Extra(NamedTuple):
    """The parts that an extra brings, by the names that users write."""

    verbs: Mapping[str, Mapping[str, Verb]] = {}
    """By the groups in the list of `framekit --help`."""
    generators: Mapping[str, Generator] = {}
    importers: Mapping[str, Importer] = {}
    """By the suffix of the files, in lower case."""
    options: Mapping[str, str] = {}
    """Objects that do the work of options (`--web`), of sections of run files (`fleet:`), and readers of files."""
    sections: Mapping[str, str] = {}
    """Functions that read sections of run files: they take the reader, the node and the folder."""
    schemas: Mapping[str, str] = {}
    """Functions that return the schemas of these sections."""
    pip: str = ""
    """Extra of `pip install` with its libraries, if it cannot do without them."""
    library: str = ""
    """Module of one of these libraries."""


EXTRAS: dict[str, Extra] = {
    "generate_c": Extra(
        generators={"c": Generator("a header and a source in C99, with nothing to link", "generate_c.command:write_c")}
    ),
    "wireshark": Extra(generators={"wireshark": Generator("a dissector in Lua", "wireshark.command:write_dissector")}),
    "kaitai": Extra(
        generators={"kaitai": Generator("a Kaitai Struct file (.ksy)", "kaitai.command:write_ksy")},
        importers={".ksy": Importer("a description of Kaitai Struct", "utf-8", "kaitai.importing:import_kaitai")},
    ),
    "documents": Extra(
        generators={
            "jsonschema": Generator("types of what decode --json prints", "documents.command:write_json_schema"),
            "typescript": Generator("the same types in TypeScript", "documents.command:write_typescript"),
            "document": Generator(
                "the frames drawn, fields, services and sequences, for people", "documents.command:write_document"
            ),
            "diagram": Generator("the sequences in Mermaid", "documents.command:write_diagram"),
        }
    ),
    "streamdevice": Extra(
        importers={
            ".proto": Importer(
                "a protocol file of EPICS StreamDevice", "latin-1", "streamdevice.importing:from_streamdevice"
            )
        }
    ),
    "guess": Extra(
        verbs={
            "Unknown lines": {
                "record": Verb(
                    "record the bytes of an unknown line, or find its speed and format",
                    "framekit.extras.guess.record_verb",
                    uses_cache=False,
                ),
                "guess": Verb(
                    "find frames, check and fields in recordings of an unknown line", "framekit.extras.guess.guess_verb"
                ),
                "diff": Verb("tell which fields differ between two recordings", "framekit.extras.guess.guess_verb"),
            }
        }
    ),
    "batch": Extra(options={"decode_many": "batch.batch:BatchDecoder"}),
    "archive": Extra(
        options={
            "decode --to": "archive.command:write_archive",
            "decode --values": "archive.command:write_values_of",
        }
    ),
    "web": Extra(
        verbs={
            "Define": {
                "edit": Verb(
                    "edit definitions and run files on a page that shows what they mean",
                    "framekit.extras.web.edit_verb",
                    uses_cache=False,
                )
            }
        },
        options={"--web": "web.web_page:WebPage"},
        pip="web",
        library="starlette",
    ),
    "screen": Extra(options={"--screen": "screen.display:show"}, pip="screen", library="textual"),
    "commreq": Extra(
        verbs={
            "Talk": {"commreq": Verb("explain or carry out command blocks", "framekit.extras.commreq.commreq_verb")}
        },
        sections={"jobs": "commreq.section:read_jobs"},
        options={"jobs:": "commreq.jobs:JobService", "NAME.jobs.yaml": "commreq.job_profiles:load_job_profile"},
    ),
    "fleet": Extra(
        verbs={
            "Fleet": {
                "fleet": Verb(
                    "list the runs that report to a broker, and roll run files out", "framekit.extras.fleet.fleet_verb"
                )
            }
        },
        sections={"fleet": "fleet.section:read_fleet"},
        schemas={"fleet": "fleet.section:fleet_schema"},
        options={"fleet:": "fleet.gateway:Gateway"},
    ),
}
"""The extras, by the names of their folders."""

GENERATORS = {name: one for extra in EXTRAS.values() for name, one in extra.generators.items()}
IMPORTERS = {suffix: one for extra in EXTRAS.values() for suffix, one in extra.importers.items()}
OPTIONS = {name: target for extra in EXTRAS.values() for name, target in extra.options.items()}
SECTIONS = {name: target for extra in EXTRAS.values() for name, target in extra.sections.items()}
SCHEMAS = {name: target for extra in EXTRAS.values() for name, target in extra.schemas.items()}


def install_hints() -> dict[str, str]:
    """Return how to install the missing library of an extra, by its verbs."""
    from importlib.util import find_spec  # takes longer than most verbs

    return {
        verb: f"pip install 'framekit[{extra.pip}]'"
        for extra in EXTRAS.values()
        if extra.library and find_spec(extra.library) is None
        for verbs in extra.verbs.values()
        for verb in verbs
    }


def load(target: str) -> Any:
    """Import the object `MODULE:NAME` of an extra."""
    module, _, name = target.partition(":")
    return getattr(import_module(f"framekit.extras.{module}"), name)
