"""New files of the editor: texts from the templates, filled in for a protocol or a device file of the folder."""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path
from typing import Any

from framekit.api.errors import RequestError
from framekit.api.new_files import NEW_KINDS, new_text
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Mapping, Node, Scalar, read_nodes
from framekit.definition.problems import DefinitionError, did_you_mean
from framekit.definition.schema import kind_of
from framekit.definition.sources import find_definition, known_definitions
from framekit.definition.written import flow, scalar
from framekit.extras.web.edit_files import ENDINGS, EditedFolder, EditRefusedError
from framekit.extras.web.edit_trial import addresses_of_forms
from framekit.runfile.channels import needs_station
from framekit.runfile.devices import Device, load_devices

Answer = dict[str, Any]

MOST_TRIED = 400
"""Largest number of addresses among which that of a word is looked for."""
LONGEST_NAME = 200
"""Largest number of characters of the name of a protocol or device file."""
_WITHOUT = "memory: {areas: {D: {unit: word, size: 1000}}}\n# blocks: {0: {call: SERVICE, channel: 1, every: 1 s}}"
_NO_LINE = re.compile("^application:", re.MULTILINE)
SERIAL, NETWORK = "/dev/ttyUSB0", "tcp://192.168.0.7"
"""Ports of a new run without a device file."""


def known(path: Path) -> Answer:
    """Return the protocols that a new file may name: those of framekit with a line of their own, by name."""
    files = (file for file in known_definitions() if "." not in file.stem)
    return {"known": sorted({file.stem for file in files if not _NO_LINE.search(file.read_text("utf-8"))})}


def new(path: Path, kind: str, name: str, of: str) -> Answer:
    """Return the name and the text of a new file in the folder of `path`.

    `of`: the protocol, or the device file of the folder, that a device, run or points file is for.
    """
    try:
        if kind not in NEW_KINDS:
            raise RequestError(f"there is no kind '{kind}' – choose {', '.join(NEW_KINDS)}")
        text = new_text(kind, name) if kind == "protocol" else _text(kind, name, of, path.parent)
    except DefinitionError as error:
        problem = error.problems[0]
        return {"why": f"{problem.what} – {problem.todo}" if problem.todo else problem.what}
    except (RequestError, EditRefusedError) as error:
        return {"why": str(error)}
    return {"name": name + NEW_KINDS[kind], "text": text}


def _text(kind: str, name: str, of: str, folder: Path) -> str:
    """Return the text of a device, run or points file. Raise RequestError, EditRefusedError, DefinitionError."""
    if not of:
        raise RequestError("choose a protocol" + ("" if kind == "device" else ", or a device file of this folder"))
    file = _file_of(of, folder)
    device = load_devices(file, folder)[0]
    root = read_nodes(file, noted=[])
    is_device = kind_of(root) == "device"
    protocol = device.protocol
    address = _address(device)
    if kind == "points":
        if not address:
            raise RequestError(f"'{protocol.name}' has no addresses of values – choose another protocol")
        return new_text(kind, name, address=scalar(address))
    named = scalar(_protocol_of(root) if is_device else of)
    if kind == "device":
        station = f"\nstation: {_station(device.station)}" if device.station else ""
        memory = f"\nmemory: {flow({'set': {address: 1}})}" if address else ""
        return new_text(kind, name, protocol=named, station=station, memory=memory)
    own = device.station or ("1" if needs_station(protocol) else "")
    return new_text(
        kind, name, protocol=named,
        port=scalar(f"sim:{of}" if is_device else SERIAL if protocol.line.kind == "serial" else NETWORK),
        station=f", station: {_station(own)}" if own else "",
        points=f"points:\n  value: {{channel: 1, address: {scalar(address)}, every: 1 s}}" if address else _WITHOUT,
    )  # fmt: skip


def _file_of(of: str, folder: Path) -> Path:
    """Return the file of a name: a YAML file in the folder, or a definition that framekit knows.

    Raise RequestError, EditRefusedError.
    """
    if len(of) > LONGEST_NAME:
        raise RequestError(f"a name of {len(of)} characters is too long – choose one of the list")
    if "/" in of or of.endswith(ENDINGS):
        return EditedFolder(folder).path_of(of if of.endswith(ENDINGS) else f"{of}{ENDINGS[0]}")
    found = None if of.startswith(".") else find_definition(f"{of}{ENDINGS[0]}", folder)
    if found is None:
        ours = {file.stem for file in known_definitions() if "." not in file.stem}
        hint = did_you_mean(of, ours | {file.stem for file in folder.glob(f"*{ENDINGS[0]}")})
        raise RequestError(f"there is no definition '{of}' – {hint or 'choose one of the list'}")
    return found


def _station(text: str) -> str:
    """Return a station as the files have it: digits as they are, any other text as a scalar."""
    return text if text.isascii() and text.isdigit() else scalar(text)


def _address(device: Device) -> str:
    """Return an address of the device: of a value, else of a word that clients may write, else any; '' without any."""
    values = [*(one.place.address for one in device.behaviours), *(place.text for place, _ in device.initial)]
    if values:
        return values[0]
    found = list(islice(addresses_of_forms(device.protocol), MOST_TRIED))
    return next((one for one in found if _is_useful(one, device.protocol, device)), found[0] if found else "")


def _is_useful(text: str, protocol: Protocol, device: Device) -> bool:
    """Return whether an address is of an element of several bits that clients may write."""
    area = protocol.areas.get(device.grammar.parse(text).area)
    return area is not None and area.access == "rw" and area.unit != "bit"


def _protocol_of(root: Node) -> str:
    """Return the protocol that a device file names."""
    node = root.get("protocol") if isinstance(root, Mapping) else None
    return node.text if isinstance(node, Scalar) else ""
