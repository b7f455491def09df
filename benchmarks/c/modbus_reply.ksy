# The reply of benchmarks/registers.yaml for Kaitai Struct. modbus_reply.cpp and .h are what its compiler 0.11.0 makes of it (cpp_stl).
meta: {id: modbus_reply, endian: be}
seq:
  - {id: station, type: u1}
  - {id: function, type: u1}
  - id: pdu
    type:
      switch-on: function
      cases: {3: registers, 0x83: exception}
  - {id: check, type: u2le}
types:
  registers:
    seq:
      - {id: bytes, type: u1}
      - {id: values, type: u2, repeat: expr, repeat-expr: bytes / 2}
  exception:
    seq:
      - {id: code, type: u1}
