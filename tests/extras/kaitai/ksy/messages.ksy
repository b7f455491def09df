meta:
  id: messages
  endian: be
params:
  - id: which
    type: s4
    enum: which
  - id: limit
    type: u1
  - id: strict
    type: bool
seq:
  - id: content
    type:
      switch-on: which
      cases:
        which::ask: ask
        which::tell: tell
enums:
  which:
    0: ask
    1: tell
types:
  ask:
    seq:
      - id: code
        contents: [5]
      - id: n
        type: u1
        valid: {expr: _ <= _root.limit}
  tell:
    seq:
      - id: code
        contents: [6]
      - id: n
        type: u1
      - id: values
        type: u2
        repeat: expr
        repeat-expr: n
      - id: sum
        type: u1
        if: _root.strict
