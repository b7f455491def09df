"""An invented protocol of nine-bit characters: the first byte of a command and the last byte of a reply are marked."""

VENDING = """
protocol: vending
line: {speed: 9600, format: 9N1}
receiver: {gap: 5 ms, resync: after_frame}
groups:
  command: {from: client, mark: first, tail: [{check: sum8}]}
  answer: {from: server, mark: last, tail: [{check: sum8}]}
frames:
  poll: {group: command, body: [{const: 0B}]}
  sell: {group: command, body: [{const: 0C}, {field: cups, type: u8}]}
  done: {from: client, body: [{const: 00}]}
  state: {group: answer, body: [{data: coins, size: rest}]}
  taken: {from: server, mark: last, body: [{const: 00}]}
sequences:
  ask:
    gives: {coins: coins}
    local: {coins: bytes}
    steps:
      - {step: ask, send: poll, receive: [{frame: state, set: {coins: it.coins}, then: next}], within: 50 ms}
      - {step: confirm, send: done}
  answer:
    steps:
      - step: idle
        receive: [{frame: poll, then: state}, {frame: sell, then: sold}, {frame: done, then: idle}]
      - {step: state, send: {state: {coins: "h'00 05 0A'"}}, then: idle}
      - {step: sold, send: taken, then: idle}
roles:
  client: {lanes: {main: {exchange: ask}}}
  machine: {lanes: {main: {listen: answer}}}
"""
