"""The verbs of the command line: their groups, a line about each, and the examples that end its help."""

from __future__ import annotations

from framekit.table_of_extras import EXTRAS, Verb, install_hints

_CORE: dict[str, dict[str, Verb]] = {
    "Try": {
        "demo": Verb("show for half a minute a simulated device, its values and its frames", "framekit.cli.demo_verb"),
    },
    "Define": {
        "new": Verb("lay out a protocol of your own", "framekit.cli.file_verbs", uses_cache=False),
        "check": Verb("check definitions and run files", "framekit.cli.definition_verbs", uses_cache=False),
        "test": Verb("run the vectors of a definition", "framekit.cli.definition_verbs", uses_cache=False),
        "frames": Verb("list protocols, frames and fields", "framekit.cli.definition_verbs"),
        "encode": Verb("make the bytes of a frame", "framekit.cli.definition_verbs"),
        "decode": Verb("show which frame some bytes are, and its fields", "framekit.cli.decode_verb"),
        "import": Verb(
            "make a definition or points of a file of another program", "framekit.cli.file_verbs", uses_cache=False
        ),
        "schema": Verb(
            "print the schemas of files, and the settings of an editor", "framekit.cli.file_verbs", uses_cache=False
        ),
    },
    "Talk": {
        "read": Verb("read values of a device", "framekit.cli.device_verbs"),
        "write": Verb("write values into a device", "framekit.cli.device_verbs"),
        "call": Verb("run another service of a device", "framekit.cli.device_verbs"),
        "scan": Verb("find stations, their speed and format, by harmless requests", "framekit.cli.scan_verb"),
    },
    "Run": {
        "run": Verb("carry out a run file", "framekit.cli.run_verb"),
        "history": Verb("show the values that a run has kept", "framekit.cli.history_verb", uses_cache=False),
    },
    "Simulate": {
        "serve": Verb("answer requests on a port, with memory", "framekit.cli.serve_verb"),
    },
    "Watch": {
        "monitor": Verb("listen to a line between others", "framekit.cli.line_verbs"),
        "replay": Verb("send the bytes of a capture again", "framekit.cli.line_verbs"),
        "loopback": Verb("test a port that is wired back to itself", "framekit.cli.line_verbs", uses_cache=False),
    },
    "Generate": {
        "generate": Verb("write stand-alone code from a definition", "framekit.cli.generate_verb"),
        "completion": Verb("print a shell's completion script", "framekit.cli.completion_verb", uses_cache=False),
    },
}
"""The verbs of the core; extras bring others."""

GROUPS: dict[str, dict[str, Verb]] = {group: dict(verbs) for group, verbs in _CORE.items()}
"""The verbs, by groups."""
for _extra in EXTRAS.values():
    for _group, _verbs in _extra.verbs.items():
        GROUPS.setdefault(_group, {}).update(_verbs)

VERBS = {verb: row for verbs in GROUPS.values() for verb, row in verbs.items()}

DOCS = "Documentation: docs/ in framekit's folder, every verb in docs/cli.md; `make docs` makes a site of it."


def examples_of(verb: str) -> list[str]:
    """Return the examples of a verb; of `framekit --help` for ''. They are in the file `examples.txt`."""
    from pathlib import Path

    text = Path(__file__).with_name("examples.txt").read_text("utf-8")
    return text.partition(f"\n[{verb}]\n")[2].partition("\n[")[0].splitlines()


def overview() -> str:
    """Return the list of verbs for `framekit --help`: groups, examples, and the place of the documentation."""
    width = max(map(len, VERBS))
    hints = {verb: f" – first {hint}" for verb, hint in install_hints().items()}
    parts = []
    for group, verbs in GROUPS.items():
        lines = [f"  {verb:<{width}}  {row.about}{hints.get(verb, '')}" for verb, row in verbs.items()]
        parts.append("\n".join([f"{group}:", *lines]))
    parts.append(examples_text(""))
    parts.append(f"framekit help VERB shows the options of a verb, and examples.\n{DOCS}")
    return "\n\n".join(parts) + "\n"


def examples_text(verb: str) -> str:
    """Return the examples of a verb as the end of its help text."""
    return "\n".join(["Examples:", *(f"  {command}" for command in examples_of(verb))])
