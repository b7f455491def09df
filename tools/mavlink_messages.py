"""Writes the messages of frames/aerial/mavlink2.yaml anew, from the tables of pymavlink's dialect `common`.

    python tools/mavlink_messages.py            # into the file, between its two marks
    python tools/mavlink_messages.py --show     # to the terminal

`MESSAGES` is the subset. A definition of your own can have others: give their names after the options, with `--show`.
"""

from __future__ import annotations

import sys
from pathlib import Path

from pymavlink.dialects.v20 import common

MESSAGES = [
    "HEARTBEAT", "SYS_STATUS", "SYSTEM_TIME", "PING", "PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "PARAM_VALUE",
    "PARAM_SET", "GPS_RAW_INT", "RAW_IMU", "SCALED_PRESSURE", "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT", "RC_CHANNELS_RAW", "SERVO_OUTPUT_RAW", "MISSION_CURRENT", "MISSION_REQUEST_LIST",
    "MISSION_COUNT", "MISSION_ACK", "MISSION_ITEM_INT", "RC_CHANNELS", "MANUAL_CONTROL", "VFR_HUD", "COMMAND_INT",
    "COMMAND_LONG", "COMMAND_ACK", "SET_POSITION_TARGET_GLOBAL_INT", "HIGHRES_IMU", "TIMESYNC", "POWER_STATUS",
    "BATTERY_STATUS", "AUTOPILOT_VERSION", "EXTENDED_SYS_STATE", "HOME_POSITION", "STATUSTEXT",
]  # fmt: skip
FILE = Path(__file__).parent.parent / "frames" / "aerial" / "mavlink2.yaml"
FIRST, LAST = "  # messages: tools/mavlink_messages.py writes them\n", "  # end of messages\n"
TYPES = {"uint8_t": "u8", "uint16_t": "u16", "uint32_t": "u32", "uint64_t": "u64", "int8_t": "i8", "int16_t": "i16"}
TYPES |= {"int32_t": "i32", "int64_t": "i64", "float": "f32", "double": "f64"}
OURS = {"sequence", "system", "component", "id", "n", "payload", "incompatible", "compatible"}
"""Names of the frame itself; a message field with such a name gets a trailing `_`."""


def name_of(name: str) -> str:
    return name + "_" if name in OURS else name


def segments(message: type) -> list[str]:
    """Return the fields of a message in wire order: texts are bytes with their zeros, arrays are lists."""
    found = []
    for name in message.ordered_fieldnames:  # type: ignore[attr-defined]
        place = message.fieldnames.index(name)  # type: ignore[attr-defined]
        kind = message.fieldtypes[place]  # type: ignore[attr-defined]
        size = message.array_lengths[message.ordered_fieldnames.index(name)]  # type: ignore[attr-defined]
        if kind == "char":
            found.append(f"{{data: {name_of(name)}, size: {size or 1}, pad: 00}}")
        elif size:
            found.append(f"{{repeat: {name_of(name)}, times: {size}, of: {TYPES[kind]}}}")
        else:
            found.append(f"{{field: {name_of(name)}, type: {TYPES[kind]}}}")
    return found


def text_of(names: list[str]) -> tuple[str, str]:
    """Return the table of the messages' extra bytes, and their frames."""
    known = {message.msgname: message for message in common.mavlink_map.values()}
    chosen = sorted((known[name] for name in names), key=lambda message: message.id)
    extra = "{" + ", ".join(f"{message.id}: {message.crc_extra}" for message in chosen) + "}"
    frames = [
        f"  {message.msgname}: {{group: message, where: {{id: {message.id}}}, body: [{{wrap: {{short: 00, min: 1}}, "
        f"name: payload, size: n, of: [{', '.join(segments(message))}]}}]}}\n"
        for message in chosen
    ]
    return extra, "".join(frames)


def main() -> None:
    names = [word for word in sys.argv[1:] if word != "--show"] or MESSAGES
    extra, frames = text_of(names)
    if "--show" in sys.argv or names is not MESSAGES:
        print(f"  crc_extra: {extra}\n\n{frames}")
        return
    text = FILE.read_text(encoding="utf-8")
    before, _, rest = text.partition(FIRST)
    behind = rest.partition(LAST)[2]
    lines = [f"  crc_extra: {extra}\n" if line.startswith("  crc_extra:") else line for line in before.splitlines(True)]
    FILE.write_text("".join(lines) + FIRST + frames + LAST + behind, encoding="utf-8")


if __name__ == "__main__":
    main()
