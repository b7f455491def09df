meta:
  id: choices
  endian: be
  encoding: ISO-8859-1
seq:
  - id: code
    type: str
    size: 1
  - id: body
    type:
      switch-on: code
      cases:
        '"A"': alpha
        '"1"': digit
        '","': comma
  - id: flag
    type: b1
  - id: kind
    type: b7
  - id: by_flag
    type:
      switch-on: flag
      cases:
        true: u1
        false: u2
  - id: by_kind
    type:
      switch-on: kind
      cases:
        1: alpha
        2: digit
        -1: comma
        _: other
  - id: list
    type:
      switch-on: kind
      cases:
        1: alpha
        _: digit
    repeat: expr
    repeat-expr: 2
  - id: left
    size-eos: true
    type:
      switch-on: by_flag
      cases:
        7: alpha
        8: other
types:
  alpha:
    seq:
      - id: x
        type: u1
  digit:
    seq:
      - id: y
        type: u2
  comma:
    seq: []
  other:
    seq:
      - id: z
        size: 2
instances:
  number:
    value: by_flag + 1
  alpha_x:
    value: body.as<alpha>.x
    if: code == "A"
