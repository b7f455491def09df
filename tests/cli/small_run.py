"""A run with a simulated device, for verbs that print while a line is active."""

from __future__ import annotations

DEVICE = "device: far\nprotocol: modbus-tcp\nstation: 1\nmemory: {set: {40001: [1, 2, 3]}}\n"
"""The device in `far.device.yaml`."""

RUN = """run: small
memory: masterlogic
channels:
  1: {port: "sim:far.device.yaml", protocol: modbus-tcp, station: 1}
blocks:
  0: {read: "40001", count: 3, into: M100, every: 5 ms}
"""
"""A run that reads from the device 200 times a second."""
