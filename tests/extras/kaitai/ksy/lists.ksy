meta:
  id: lists
  endian: be
  encoding: ISO-8859-1
seq:
  - id: n
    type: u1
    valid: {max: 6}
  - id: shift
    type: s1
  - id: words
    type: u2
    repeat: expr
    repeat-expr: n - shift
  - id: names
    type: strz
    repeat: expr
    repeat-expr: n
  - id: chunks
    size: 2
    repeat: expr
    repeat-expr: 2
  - id: varint
    type: septet
    repeat: until
    repeat-until: not _.more
  - id: codes
    type: u1
    repeat: until
    repeat-until: _ == 0 or _ == n
  - id: kinds
    type: u1
    enum: kind
    repeat: expr
    repeat-expr: 2
  - id: sized
    size: 3
    type: point
    repeat: expr
    repeat-expr: n & 1
  - id: grown
    type: grown(_index)
    repeat: expr
    repeat-expr: 2
  - id: levels
    type: u1
    repeat: expr
    repeat-expr: 2
    valid: {max: 200}
types:
  septet:
    seq:
      - id: more
        type: b1
      - id: value
        type: b7
  point:
    seq:
      - id: x
        type: s1
      - id: y
        type: s1
  grown:
    params:
      - id: number
        type: s4
    seq:
      - id: data
        size: number + 1
    instances:
      twice:
        value: number * 2 + _parent.n
enums:
  kind:
    1: one
    2: two
instances:
  first:
    value: varint[0].value
  last_code:
    value: codes.last
  how_many:
    value: codes.size + words.size
  second_kind:
    value: kinds[1] == kind::two
