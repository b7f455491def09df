meta:
  id: rest
  endian: le
seq:
  - id: len
    type: u1
  - id: box
    type: box
    size: len
  - id: items
    type: item
    size: 4
  - id: data
    size: _io.size - _io.pos - 3
  - id: end
    contents: [0x03]
  - id: check
    type: u2
types:
  box:
    seq:
      - id: a
        type: u1
      - id: payload
        size: _io.size - _io.pos - 1
      - id: b
        type: u1
        valid: {min: 1}
  item:
    seq:
      - id: one
        type: u1
      - id: two
        type: u1
        if: one == 2
