meta:
  id: names
  endian: le
  encoding: ASCII
seq:
  - id: magic
    contents: ['0x02', '7', AB, +3]
  - id: kind
    type: u1
  - id: rest
    type: u1
  - id: data
    size: rest
  - id: outer
    type: 'outer::user'
  - id: flag
    type: b1
  - id: index
    type: b7
  - id: body
    type:
      switch-on: kind
      cases:
        1: sized(1, 4)
        2: sized(2, 4)
types:
  outer:
    seq:
      - id: wide
        type: u4
    types:
      outer:
        seq:
          - id: narrow
            type: u1
      user:
        seq:
          - id: inner
            type: outer
  sized:
    params:
      - id: how
        type: u1
      - id: same
        type: u1
    seq:
      - id: part
        type: part(how)
  part:
    params:
      - id: how
        type: u1
    seq:
      - id: x
        size: how
instances:
  is_one:
    value: kind == 1
  as_number:
    value: is_one.to_i
  as_text:
    value: '(kind == 1).to_i.to_s + flag.to_i.to_s'
  in_sum:
    value: is_one.to_i * 10 + flag.to_i
  octal:
    value: '"\1014\0\e\"\\" + "\47"'
  same:
    value: body.as<sized>.same
    if: kind == 1 or kind == 2
  read:
    value: body.as<sized>.part.x
    if: kind == 1 or kind == 2
