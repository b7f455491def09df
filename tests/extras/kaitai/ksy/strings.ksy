meta:
  id: strings
  encoding: UTF-8
seq:
  - id: first
    type: strz
  - id: second
    type: str
    size: 4
    encoding: ASCII
  - id: third
    type: str
    terminator: 0x2c
    encoding: ISO-8859-1
  - id: fourth
    type: str
    terminator: 0x3b
    consume: false
  - id: sign
    contents: ";"
  - id: fifth
    type: strz
    size: 5
    encoding: latin1
  - id: line
    terminator: 0x0a
  - id: len
    type: u1
  - id: sixth
    type: str
    size: len
    encoding: ISO-8859-1
    pad-right: 0
  - id: digits
    type: str
    size: 3
    encoding: ISO-8859-1
    valid:
      expr: _ != "000"
instances:
  number:
    value: digits.to_i
    if: sixth == "n"
  whole:
    value: first + "-" + third
  part:
    value: second.substring(1, 3)
  size:
    value: whole.length + line.length
