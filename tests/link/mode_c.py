# ruff: noqa: E501 - a definition in YAML
"""IEC 62056-21 mode C, as far as a readout needs it (6.3, 6.4): start at 300 baud 7E1, continue at the agreed speed."""

MODE_C = """
protocol: mode_c
line: {speed: 300, format: 7E1}
params: {offers: {type: number, default: 0x35}}
tables: {speeds: {0x30: 300, 0x31: 600, 0x32: 1200, 0x33: 2400, 0x34: 4800, 0x35: 9600, 0x36: 19200}}
frames:
  sign_on: {from: client, body: [{text: '/?!'}, {const: CR LF}]}
  identification: {from: server, body: [{text: /}, {data: maker, size: 3}, {field: baud, type: u8}, {data: type, size: rest}, {const: CR LF}]}
  acknowledge: {from: client, body: [{const: ACK}, {text: '0'}, {field: baud, type: u8}, {text: '0'}, {const: CR LF}]}
  readout: {from: server, body: [{const: STX}, {data: block, size: rest}, {const: 21 0D 0A 03, name: tail}, {check: xor7, over: [block, tail]}]}
sequences:
  read_out:
    gives: {block: block, speed: speed, limit: limit}
    local: {block: bytes, baud: number, speed: number, limit: time}
    steps:
      - {step: fresh, line: own}
      - step: sign_on
        send: sign_on
        receive: [{frame: identification, set: {baud: it.baud}, then: next}]
        within: 1500 ms
        complete: 3 s
      - step: agree
        wait: 200 ms
        send: {acknowledge: {baud: baud}}
        line: {speed: 'speeds[baud]', format: 7E1}
        receive: [{frame: readout, set: {block: it.block, speed: line.speed, limit: 10 chars}, then: end}]
        within: 1500 ms
        complete: 100 chars
  answer:
    local: {baud: number}
    on_timeout: {then: idle}
    steps:
      - step: idle
        line: own
        receive: [{frame: sign_on, then: next}]
      - step: identify
        wait: 200 ms
        send: {identification: {maker: "h'41 42 43'", baud: offers, type: "h'4D 45 54 45 52'"}}
        receive: [{frame: acknowledge, set: {baud: it.baud}, then: next}]
        within: 1500 ms
        complete: 1 s
      - {step: change, line: {speed: 'speeds[baud]'}, wait: 200 ms}
      - {step: data, send: {readout: {block: "h'31 2E 38 2E 30 28 30 30 30 34 32 29 0D 0A'"}}}
roles:
  client: {lanes: {main: {exchange: read_out}}, other_side: meter}
  meter: {lanes: {main: {listen: answer}}}
"""
