"""Build the documentation site: `make docs`, or `python tools/site.py`.

The pages keep the layout of the repository, so all links between them remain valid; the gallery of protocols is added,
each page made from its definition, and MkDocs builds the site. The build needs no network: search and styles are the
site's own, and diagrams are drawn by the package `mermaid` if npm has it, else shown as text.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

from framekit.cli.common import ProgressLine

ROOT = Path(__file__).parents[1]
MERMAID = "mermaid@11"
SECTIONS: dict[str, list[str]] = {
    "Start": ["docs/first-protocol.md", "docs/editor.md", "docs/cookbook.md", "examples/README.md"],
    "How to": [
        "docs/howto/log-values.md", "docs/howto/simulate-a-device.md", "docs/howto/unknown-check.md",
        "docs/howto/find-devices.md",
        "docs/howto/listen-between.md", "docs/howto/import-streamdevice.md", "docs/howto/import-kaitai.md",
        "docs/howto/run-as-a-service.md",
        "docs/generate-c.md", "docs/wireshark.md", "docs/kaitai.md",
    ],
    "Devices and lines": [
        "docs/run-files.md", "docs/run-memory.md", "docs/run-commands.md", "docs/run-stations.md", "docs/run-edits.md",
        "docs/servers.md", "docs/behave.md", "docs/lines.md", "docs/modems.md", "docs/faults.md", "docs/jobs.md",
        "docs/slow-devices.md", "docs/own-echo.md",
        "docs/diagnosis.md", "docs/captures.md", "docs/unknown.md", "docs/guess.md", "docs/guess-details.md",
        "docs/web.md", "docs/exposing.md", "docs/systems.md",
    ],
    "Values": ["docs/points.md", "docs/sinks.md", "docs/sinks-servers.md", "docs/mqtt.md", "docs/fleets.md"],
    "The language": [
        "docs/language.md", *sorted(str(page.relative_to(ROOT)) for page in ROOT.glob("docs/language/*.md")),
        "docs/conversion.md", "docs/text-numbers.md", "docs/sharing.md",
    ],
    "Reference": [
        "docs/reference.md", *sorted(str(page.relative_to(ROOT)) for page in ROOT.glob("docs/reference/*.md")),
        "docs/segments.md", *sorted(str(page.relative_to(ROOT)) for page in ROOT.glob("docs/segments/*.md")),
        "docs/cli.md", *sorted(str(page.relative_to(ROOT)) for page in ROOT.glob("docs/cli/*.md")),
        "docs/error-codes.md",
        "docs/python-api.md", "docs/python-frames.md", "docs/python-runs.md", "docs/glossary.md",
    ],
    "How it works": [
        "docs/architecture.md", "docs/receiver.md", "docs/performance.md", "docs/internals/performance.md",
        "docs/internals/performance-frames.md",
        "docs/internals/frames.md", "docs/internals/receiver.md", "docs/internals/engine.md",
        "docs/internals/late-replies.md", "docs/internals/speed.md",
        "docs/internals/guess.md", "docs/internals/tests.md", "docs/extending.md",
        "docs/extending-ports.md", "docs/extending-values.md", "CONTRIBUTING.md",
    ],
    "Protocols": sorted(str(page.relative_to(ROOT)) for page in ROOT.glob("docs/protocols/*.md")),
}  # fmt: skip
"""Sections of the site and their pages. A page that is not listed comes last, in More."""
STYLE = ".md-grid{max-width:1280px}.md-typeset table:not([class]){font-size:.72rem}\n"


def files_of(folder: str) -> list[str]:
    """Return the files of a folder that belong to the repository, without files created by trying the examples."""
    found = subprocess.run(["git", "ls-files", "-z", folder], cwd=ROOT, capture_output=True, text=True, check=False)
    if found.returncode == 0 and found.stdout:
        return [file for file in found.stdout.split("\0") if file and (ROOT / file).is_file()]
    return [str(file.relative_to(ROOT)) for file in (ROOT / folder).rglob("*") if "__pycache__" not in file.parts]


def lay_out(pages: Path) -> None:
    """Write the pages: README, docs, examples and frames as they are in the repository, and the gallery."""
    shutil.rmtree(pages, ignore_errors=True)
    for folder in ("docs", "examples", "frames"):
        for file in files_of(folder):
            place = pages / file
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / file, place)
    shutil.copy(ROOT / "README.md", pages / "index.md")
    for file in ("CONTRIBUTING.md", "SECURITY.md"):
        shutil.copy(ROOT / file, pages / file)
    tests = pages / "tests"  # pages name a few tests
    text = "".join(page.read_text("utf-8") for page in pages.glob("docs/**/*.md"))
    for target in [*ROOT.glob("tests/**/*.py"), *ROOT.glob("tests/checklists/*.md")]:
        if f"{target.relative_to(ROOT)})" in text:
            place = tests / target.relative_to(ROOT / "tests")
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(target, place)
    (pages / "site.css").write_text(STYLE, "utf-8")


def gallery(pages: Path) -> list[str]:
    """Write a page for each shipped protocol, made from its definition; return the pages by family."""
    from framekit.api.vectors import vectors_path
    from framekit.definition.load.protocol import load_protocol
    from framekit.definition.sources import shipped_definitions
    from framekit.extras.documents.document import document, markdown

    folder, rows = pages / "gallery", []
    folder.mkdir()
    for path in shipped_definitions():
        if "." in path.stem:
            continue
        protocol = load_protocol(path)
        text, pictures = markdown(document(protocol, vectors_path(path)), f"{path.stem}.frames")
        (folder / f"{path.stem}.frames").mkdir()
        for name, picture in pictures.items():
            (folder / f"{path.stem}.frames" / name).write_text(picture, "utf-8")
        (folder / f"{path.stem}.md").write_text(text, "utf-8")
        rows.append((protocol.family, path.stem, protocol.about))
    rows.sort()
    lines = ["# Gallery", "", "Every shipped protocol: its frames drawn, its fields, services and sequences.", ""]
    lines += ["| family | protocol | about |", "|---|---|---|"]
    lines += [f"| {family} | [{name}]({name}.md) | {about} |" for family, name, about in rows]
    (folder / "index.md").write_text("\n".join(lines) + "\n", "utf-8")
    return ["gallery/index.md", *(f"gallery/{name}.md" for _, name, _ in rows)]


def api(pages: Path) -> str:
    """Write the page of the names of `import framekit`, made from the docstrings."""
    import framekit

    lines = [
        "# Python API: every name",
        "",
        "What `import framekit` offers, from the docstrings. "
        "[A client in Python](docs/python-api.md) shows it at work.",
        "",
    ]
    homes = {name: home for home, names in framekit._HOMES.items() for name in names}
    for name in sorted(framekit.__all__, key=str.lower):
        hidden = name in ("connect", "serve")  # they have the arguments of aconnect and aserve
        options = "\n    options: {show_signature: false}" if hidden else ""
        lines.append(f"::: framekit.{homes[name]}.{name}{options}")
    (pages / "api.md").write_text("\n\n".join(lines) + "\n", "utf-8")
    return "api.md"


def mermaid(pages: Path) -> bool:
    """Return whether the package that draws diagrams is available; if so, write its file next to the pages."""
    if shutil.which("npm") is None:
        return False
    with tempfile.TemporaryDirectory() as folder:
        command = ["npm", "install", "--silent", "--no-save", "--prefix", folder, MERMAID]
        if subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode:
            return False
        shutil.copy(Path(folder) / "node_modules" / "mermaid" / "dist" / "mermaid.min.js", pages / "mermaid.min.js")
    return True


def navigation(folder: Path, drawn: list[str], api_page: str) -> list[object]:
    """Return the pages by section, the pages without a section, and the generated pages: gallery and API."""
    made = [*drawn, api_page]
    known = {page for listed in SECTIONS.values() for page in listed}
    existing = {str(page.relative_to(folder)) for page in folder.glob("**/*.md")} - {"index.md"} - set(made)
    sections = {**SECTIONS, "More": sorted(existing - known), "Gallery": drawn}
    sections["Reference"] = [*sections["Reference"], api_page]
    found: list[object] = ["index.md"]
    for name, listed in sections.items():
        inside = [page for page in listed if page in existing or page in made]
        found += [{name: inside}] if inside else []
    return found


def build(place: Path, with_diagrams: bool, progress: ProgressLine) -> int:
    """Build the site in `place/site`; return the exit status of MkDocs, which is not 0 for a broken link."""
    progress.says = lambda: "pages and the gallery"
    pages = place / "pages"
    lay_out(pages)
    drawn, api_page = gallery(pages), api(pages)
    extra = ["mermaid.min.js"] if with_diagrams and mermaid(pages) else []
    for page in [] if extra else pages.glob("**/*.md"):  # otherwise the theme loads it from another server
        page.write_text(page.read_text("utf-8").replace("```mermaid\n", "```text\n"), "utf-8")
    rest = {"nav": navigation(pages, drawn, api_page), "extra_javascript": extra}
    lines = [f"INHERIT: {ROOT / 'mkdocs.yml'}", f"docs_dir: {pages}", f"site_dir: {place / 'site'}"]
    settings = place / "mkdocs.yml"
    settings.write_text("\n".join([*lines, yaml.safe_dump(rest, sort_keys=False)]), "utf-8")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", str(settings)]
    settings_of_mkdocs = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    progress.says = lambda: "the site"
    done = subprocess.run(command, env=settings_of_mkdocs, stderr=subprocess.PIPE, text=True)
    if done.returncode:  # quiet, it would count no warnings
        print(done.stderr, file=sys.stderr)
    return done.returncode


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Builds the documentation site.")
    parser.add_argument("--no-diagrams", action="store_true", help="show diagrams as text")
    parser.add_argument(
        "-o", "--output", type=Path, default=ROOT / "build", help="where; the site is in its folder site"
    )
    given = parser.parse_args()
    with ProgressLine("docs") as progress:
        status = build(given.output.resolve(), not given.no_diagrams, progress)
    sys.exit(status)
