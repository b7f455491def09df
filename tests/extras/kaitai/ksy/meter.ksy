meta:
  id: meter
  title: A small meter
  endian: le
  encoding: ASCII
doc: One telegram with the values of a meter.
doc-ref: made for this test
seq:
  - id: magic
    contents: [0x4d, 0x54]
  - id: version
    type: u1
    valid:
      min: 1
      max: 3
  - id: serial
    type: u4
    doc: number on the plate
  - id: kind
    type: u1
    enum: kind
  - id: station
    type: u1
    valid:
      any-of: [1, 2, 5, 7]
  - id: name
    type: str
    size: 6
    pad-right: 0x20
  - id: temperature
    type: s2be
  - id: energy
    type: u8
  - id: flow
    type: f4
  - id: pressure
    type: f8be
  - id: reading
    type: reading(kind == kind::heat)
  - id: count
    type: u1
  - id: history
    type: u2
    repeat: expr
    repeat-expr: count
  - id: mark
    type: s1
    valid: -3
types:
  reading:
    params:
      - id: is_heat
        type: bool
    seq:
      - id: unit
        type: u1
        enum: unit
      - id: value
        type: s4
      - id: return_value
        type: s4
        if: is_heat
    enums:
      unit:
        1: watt
        2:
          id: kilowatt
          doc: thousand watts
instances:
  tenths:
    value: temperature * 10 + 5
  is_cold:
    value: temperature < 0
  word:
    value: 'is_cold ? "cold" : "warm"'
  spread:
    value: "history.size > 0 ? history.max - history.min : 0"
  flags:
    value: (serial >> 4) & 0xf | (version << 4) ^ 1
  share:
    value: serial / count
    if: count != 0
enums:
  kind:
    0: water
    1: heat
    7: gas
