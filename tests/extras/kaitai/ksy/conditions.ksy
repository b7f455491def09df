meta:
  id: conditions
  endian: be
seq:
  - id: head
    type: head
  - id: a
    type: u1
    if: head.flags & 1 != 0
  - id: b
    type: u2
    if: head.has_b and a == 3
  - id: c
    type: c
    if: not (head.flags == 0 or head.flags >= 0x80)
  - id: d
    size: 'head.has_b ? 2 : 1'
  - id: more
    type: u1
    if: not _io.eof
  - id: even_more
    type: u2
    if: not _io.eof
types:
  head:
    seq:
      - id: flags
        type: u1
    instances:
      has_b:
        value: flags & 2 == 2
  c:
    seq:
      - id: x
        type: u1
        valid:
          expr: _ < 9 or _root.head.flags == 5
      - id: y
        type: deep
    types:
      deep:
        seq:
          - id: z
            size: _parent.x % 3
          - id: w
            type: u1
            if: _root.head.flags == 4 and _parent._parent.head.has_b == false
instances:
  with_a:
    value: a + 1
  w_plus:
    value: c.y.w + 1
    if: head.flags == 4
  guarded:
    value: 'head.flags & 1 != 0 ? a : 0 - 1'
  floor:
    value: -head.flags / 7
  rest:
    value: (0 - head.flags) % 7
