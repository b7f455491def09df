"""The verbs of the command line: their groups, a line about each, and the examples that end its help."""

from __future__ import annotations

GROUPS: dict[str, dict[str, str]] = {
    "Try": {
        "demo": "show for half a minute a simulated device, its values and its frames",
    },
    "Define": {
        "new": "lay out a protocol of your own",
        "check": "check definitions and run files",
        "test": "run the vectors of a definition",
        "frames": "list protocols, frames and fields",
        "encode": "make the bytes of a frame",
        "decode": "tell which frame some bytes are, and its fields",
        "edit": "edit definitions and run files on a page that shows what they mean",
        "import": "make a definition or points of a file of another program",
        "schema": "print the schemas of files, and the settings of an editor",
    },
    "Talk": {
        "read": "read values of a device",
        "write": "write values into a device",
        "call": "run another service of a device",
        "scan": "find stations, their speed and format, by harmless requests",
        "commreq": "explain or carry out command blocks",
    },
    "Run": {
        "run": "carry out a run file",
        "history": "show the values that a run has kept",
    },
    "Simulate": {
        "serve": "answer requests on a port, with memory",
    },
    "Watch": {
        "monitor": "listen to a line between others",
        "replay": "send the bytes of a capture again",
        "loopback": "test a port that is wired back to itself",
    },
    "Generate": {
        "generate": "write stand-alone code from a definition",
        "completion": "print a shell's completion script",
    },
    "Unknown lines": {
        "record": "record the bytes of an unknown line, or find its speed and format",
        "guess": "find frames, check and fields in recordings of an unknown line",
        "diff": "tell which fields differ between two recordings",
    },
    "Fleet": {
        "fleet": "list the runs that report to a broker, and roll run files out",
    },
}
"""A line about each verb, by groups."""

VERBS = {verb: about for verbs in GROUPS.values() for verb, about in verbs.items()}

DOCS = "Documentation: docs/ in framekit's folder, every verb in docs/cli.md; `make docs` makes a site of it."


def examples_of(verb: str) -> list[str]:
    """Return the examples of a verb; of `framekit --help` for ''. They are in the file `examples.txt`."""
    from pathlib import Path

    text = Path(__file__).with_name("examples.txt").read_text("utf-8")
    return text.partition(f"\n[{verb}]\n")[2].partition("\n[")[0].splitlines()


def overview() -> str:
    """Return the list of verbs for `framekit --help`: groups, examples, and the place of the documentation."""
    width = max(map(len, VERBS))
    parts = []
    for group, verbs in GROUPS.items():
        lines = [f"  {verb:<{width}}  {about}" for verb, about in verbs.items()]
        parts.append("\n".join([f"{group}:", *lines]))
    parts.append(examples_text(""))
    parts.append(f"framekit help VERB shows the options of a verb, and examples.\n{DOCS}")
    return "\n\n".join(parts) + "\n"


def examples_text(verb: str) -> str:
    """Return the examples of a verb as the end of its help text."""
    return "\n".join(["Examples:", *(f"  {command}" for command in examples_of(verb))])
