"""The verbs of the command line: their groups, a line about each, and the examples that end the help of each."""

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

OVERVIEW_EXAMPLES = (
    "framekit demo",
    "framekit read modbus-rtu --port /dev/ttyUSB0 --station 1 40001 -n 4",
    "framekit run plant.run.yaml",
)
"""The examples of `framekit --help`."""

EXAMPLES: dict[str, tuple[str, str]] = {
    "demo": ("framekit demo", "framekit demo --fast"),
    "new": ("framekit new protocol acme-meter", "framekit new protocol acme-meter -o meter"),
    "check": ("framekit check scale.yaml scale.run.yaml", "framekit check oven.run.yaml --load"),
    "test": ("framekit test scale.yaml", "framekit test modbus-rtu"),
    "frames": ("framekit frames", "framekit frames modbus-rtu"),
    "encode": (
        "framekit encode scale.yaml ASK station=1",
        "framekit encode modbus-rtu request_adu station=1 pdu.read_holding.address=0 pdu.read_holding.count=3",
    ),
    "decode": (
        "framekit decode scale.yaml 02 57 30 31 03 35 37",
        "framekit decode modbus-rtu --capture line.jsonl --bad",
    ),
    "edit": ("framekit edit oven.run.yaml", "framekit edit . --web 8041"),
    "import": ("framekit import psu.proto", "framekit import registers.csv --add 40001 --order ABCD"),
    "schema": ("framekit schema run", "framekit schema --vscode"),
    "read": (
        "framekit read modbus-rtu --port /dev/ttyUSB0 --station 1 40001 -n 3",
        "framekit read modbus-tcp --port sim:oven.device.yaml --station 1 holding:0x0 --every 1s",
    ),
    "write": (
        "framekit write modbus-rtu --port /dev/ttyUSB0 --station 1 40010 21.5 --type float32",
        "framekit write modbus-tcp --port sim:oven.device.yaml --station 1 40002 1850",
    ),
    "call": (
        "framekit call modbus-rtu --port /dev/ttyUSB0 --station 1 identify",
        "framekit call modbus-rtu --port /dev/ttyUSB0 --station 1 identify --json",
    ),
    "scan": (
        "framekit scan /dev/ttyUSB0 modbus-rtu --stations 1..10 --timeout 200ms",
        "framekit scan tcp://{host} modbus-tcp --hosts 10.0.0.0/28 --stations 1 --json",
    ),
    "commreq": (
        "framekit commreq ccm --explain 6 0 8 9 0 0 0x17DF 10 1 200 50 1",
        "framekit commreq snp --explain snp_attach id=SNPID1 piggy_type=R piggy_address=171 status_offset=9",
    ),
    "run": ("framekit run oven.run.yaml", "framekit run oven.run.yaml --virtual --for 6min"),
    "history": ("framekit history meter.run.yaml --since 1h", "framekit history meter.run.yaml --point 'temp*' --csv"),
    "serve": (
        "framekit serve oven.device.yaml --port tcp-listen://127.0.0.1:5020",
        "framekit serve modbus-rtu --port pty: --station 1,2 --set 40001=100,200",
    ),
    "monitor": (
        "framekit monitor modbus-rtu --port /dev/ttyUSB0",
        "framekit monitor modbus-rtu --port /dev/ttyUSB0 --bad --capture bad.jsonl",
    ),
    "replay": (
        "framekit replay line.jsonl --port /dev/ttyUSB0",
        "framekit replay line.jsonl --port /dev/ttyUSB0 --direction out --as-fast",
    ),
    "loopback": ("framekit loopback /dev/ttyUSB0", "framekit loopback sim:loop --speeds 9600,19200 --formats 8N1,8E1"),
    "generate": (
        "framekit generate python scale.yaml -o scale_codec.py",
        "framekit generate document modbus-rtu -o modbus-rtu.html",
    ),
    "completion": ("framekit completion bash", "framekit completion zsh"),
    "record": ("framekit record /dev/ttyUSB0 -o found.jsonl", "framekit record /dev/ttyUSB0 --try --speeds 9600,19200"),
    "guess": ("framekit guess line.jsonl", "framekit guess line.jsonl --write found.yaml"),
    "diff": ("framekit diff off.jsonl on.jsonl", "framekit diff off.jsonl on.jsonl --with modbus-rtu"),
    "fleet": ("framekit fleet broker.local", "framekit fleet broker.local --watch --for 10s"),
}
"""Two commands for each verb; tests execute them in the folder `examples`."""

DOCS = "Documentation: docs/ in framekit's folder, every verb in docs/cli.md; `make docs` makes a site of it."


def overview() -> str:
    """Return the list of verbs for `framekit --help`: groups, examples, and the place of the documentation."""
    width = max(map(len, VERBS))
    parts = []
    for group, verbs in GROUPS.items():
        lines = [f"  {verb:<{width}}  {about}" for verb, about in verbs.items()]
        parts.append("\n".join([f"{group}:", *lines]))
    parts.append(examples_text(OVERVIEW_EXAMPLES))
    parts.append(f"framekit help VERB shows the options of a verb, and examples.\n{DOCS}")
    return "\n\n".join(parts) + "\n"


def examples_text(commands: tuple[str, ...]) -> str:
    """Return examples as the end of a help text."""
    return "\n".join(["Examples:", *(f"  {command}" for command in commands)])
