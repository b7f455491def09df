meta:
  id: tlv
  endian: be
  encoding: ISO-8859-1
seq:
  - id: header
    type: header
  - id: records
    type: record
    repeat: eos
types:
  header:
    seq:
      - id: station
        type: u1
      - id: len_pad
        type: u1
      - id: pad
        size: len_pad % 4
  record:
    seq:
      - id: tag
        type: u1
        enum: tag
      - id: len
        type: u1
      - id: body
        size: len
        type:
          switch-on: tag
          cases:
            tag::number: number
            tag::text: text
            tag::pair: pair
    instances:
      is_mine:
        value: _parent.header.station == 7
    types:
      number:
        seq:
          - id: value
            type: u2
      text:
        seq:
          - id: text
            type: str
            size: _parent.len - 1
          - id: end
            contents: [0]
      pair:
        seq:
          - id: first
            type: number
          - id: rest
            size-eos: true
    enums:
      tag:
        1: number
        2: text
        3: pair
        4: word
