meta:
  id: bits
  endian: be
  bit-endian: be
seq:
  - id: ready
    type: b1
  - id: mode
    type: b3
    enum: mode
  - id: level
    type: b12
  - id: tail
    type: b5
    valid:
      max: 20
  - id: after
    type: u1
  - id: low
    type: b3le
  - id: wide
    type: b13le
  - id: three
    type: b24
  - id: three_le
    type: b24le
  - id: flagged
    type: b1
  - id: spare
    type: b7
  - id: more
    size: 1
    if: ready and not flagged
  - id: inner
    type: pack
    repeat: expr
    repeat-expr: mode.to_i
  - id: last
    type: b2
types:
  pack:
    seq:
      - id: a
        type: b4
      - id: b
        type: b4
enums:
  mode:
    0: off
    1: manual
    5: automatic
instances:
  sum:
    value: level + tail * 2 - low
