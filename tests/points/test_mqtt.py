"""Values to an MQTT broker and back, with Debian's mosquitto."""

from __future__ import annotations

import datetime
import json
import logging
import subprocess
from pathlib import Path
from typing import Any

import pytest
from points.mosquitto import Broker, Listener, needs_mosquitto
from points.test_sinks import DEVICE, run_file

from framekit.api.run import Run, VirtualRun, loaded
from framekit.definition.problems import DefinitionError
from framekit.sinks.mqtt import _PLAIN, _as_id, parsed

pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")

RUN = """run: boiler
channels:
  1: {{port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}}
points:
  temperature: {{channel: 1, address: "40001", scale: 0.1, unit: °C}}
  mode: {{channel: 1, address: "40002", enum: {{0: off, 2: heating}}, access: rw}}
  setpoint: {{channel: 1, address: "40005", scale: 0.1, access: rw, range: 5..60}}
sinks:
  - {{mqtt: "127.0.0.1:{port}"{more}}}
"""


def boiler(folder: Path, port: int, more: str = "") -> Path:
    (folder / "meter.device.yaml").write_text(DEVICE, "utf-8")
    path = folder / "boiler.run.yaml"
    path.write_text(RUN.format(port=port, more=more), "utf-8")
    return path


@needs_mosquitto
def test_values_are_published_kept_and_the_end_is_told(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Listener(broker.port, "#") as listener:
        with VirtualRun(boiler(tmp_path, broker.port)) as run:
            run.run_for("1500 ms")
            run.device("meter").write("40001", 220)
            run.run_for("1 s")
        listener.wait(lambda: listener.of("framekit/boiler/status") == [b"online", b"offline"])
        values = [json.loads(payload) for payload in listener.of("framekit/boiler/temperature")]
        first = {"point": "temperature", "unit": "°C", "quality": "good"}
        assert values == [
            {**first, "time": "2000-01-01T00:00:00.001Z", "value": 21.7},
            {**first, "time": "2000-01-01T00:00:02.001Z", "value": 22.0},
        ]
        assert json.loads(listener.of("framekit/boiler/mode")[0])["value"] == "heating"
        with Listener(broker.port, "framekit/boiler/temperature") as late:
            late.wait(lambda: late.heard)
            assert late.heard == [("framekit/boiler/temperature", listener.of("framekit/boiler/temperature")[1], True)]


@needs_mosquitto
def test_plain_values_by_a_topic_of_ones_own(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Listener(broker.port, "a/#") as listener:
        path = boiler(tmp_path, broker.port, ', topic: "a/{point}/of/{run}", payload: plain, retain: no, points: temp*')
        with VirtualRun(path) as run:
            run.run_for("1500 ms")
            run.enable_channel(1, False)
            run.run_for("10 s")
        listener.wait(lambda: len(listener.heard) == 2)
        assert [payload for _, payload, _ in listener.heard] == [b"21.7", b""]  # no value any more


@needs_mosquitto
def test_values_are_written_back_and_others_refused(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "framekit")
    with Broker(tmp_path) as broker, Listener(broker.port, "framekit/#") as listener:
        set_, answer = "framekit/boiler/setpoint/set", "framekit/boiler/setpoint/set/answer"
        listener.say(set_, "33", retain=True)  # an old message that the broker has retained
        with Run(boiler(tmp_path, broker.port, ", commands: yes")) as run:
            listener.wait(lambda: listener.of("framekit/boiler/setpoint"))
            listener.say(set_, "45.5")
            listener.wait(lambda: len(listener.of(answer)) == 1)
            listener.say(set_, '{"value": 99, "who": "anna", "id": 7}')
            listener.wait(lambda: len(listener.of(answer)) == 2)
            listener.say(set_, '{"valeu": 9}')
            listener.say(set_, "much")
            listener.wait(lambda: len(listener.of(answer)) == 4)
            listener.say(set_, r'{"value": 98, "id": "\ud800"}')  # half a character
            listener.wait(lambda: len(listener.of(answer)) == 5)
            listener.say("framekit/boiler/mode/set", "off")
            listener.say("framekit/boiler/temperature/set", "5")
            listener.wait(lambda: any(b'"off"' in message for message in listener.of("framekit/boiler/mode")))
            assert run.device("meter")["40005"] == 455
        answers = [json.loads(message) for message in listener.of(answer)]
        assert answers[0] == {"point": "setpoint", "value": 45.5, "ok": True}
        assert answers[1] == {
            "point": "setpoint", "value": 99, "id": 7, "ok": False,
            "reason": "99 is not in 5..60, the range of setpoint",
        }  # fmt: skip
        assert not any(answer["ok"] for answer in answers[2:])
        assert answers.pop()["id"] == "\ud800"
        assert {answer["reason"] for answer in answers[2:]} == {
            "'much' is no number", 'this is no value – send it by itself, or as {"value": 5}',
        }  # fmt: skip
        assert listener.of("framekit/boiler/temperature/set/answer") == []
    logged = [record.getMessage() for record in caplog.records]
    place = f"127.0.0.1:{broker.port}"
    assert f"point setpoint: 0.0 → 45.5, written by 'a client' by {set_} of {place}" in logged
    why = "99 is not in 5..60, the range of setpoint"
    assert f"point setpoint: 99 was refused to 'anna' by {set_} of {place}: {why}" in logged
    assert not any(line.startswith(("point setpoint: 0.0 → 33", "point setpoint: 33")) for line in logged)


@needs_mosquitto
def test_home_assistant_is_told(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Listener(broker.port, "homeassistant/#") as listener:
        with VirtualRun(boiler(tmp_path, broker.port, ", commands: yes, discovery: homeassistant")) as run:
            run.run_for("1500 ms")
        listener.wait(lambda: len(listener.heard) == 3)
    messages = {topic: json.loads(payload) for topic, payload, _ in listener.heard}
    sensor = messages["homeassistant/sensor/framekit_boiler_temperature/config"]
    assert (sensor["state_topic"], sensor["unit_of_measurement"]) == ("framekit/boiler/temperature", "°C")
    number = messages["homeassistant/number/framekit_boiler_setpoint/config"]
    assert (number["min"], number["max"], number["step"]) == (5, 60, 0.1)
    assert number["command_topic"] == "framekit/boiler/setpoint/set"
    assert messages["homeassistant/select/framekit_boiler_mode/config"]["options"] == ["off", "heating"]


def certificates(folder: Path) -> None:
    """Write `ca.pem`, and `server.pem` signed by it with `server.key`, for 127.0.0.1."""
    pytest.importorskip("cryptography", reason="cryptography is not installed")
    import ipaddress

    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    def name(text: str) -> x509.Name:
        return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])

    def certificate(subject: str, key: Any, signer: Any, is_ca: bool) -> bytes:
        now = datetime.datetime.now(datetime.UTC)
        address = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
        made = (
            x509.CertificateBuilder().subject_name(name(subject)).issuer_name(name("ca")).public_key(key.public_key())
        )
        made = made.serial_number(x509.random_serial_number()).not_valid_before(now - datetime.timedelta(days=1))
        made = made.not_valid_after(now + datetime.timedelta(days=1)).add_extension(address, False)
        made = made.add_extension(x509.BasicConstraints(is_ca, None), True)
        return made.sign(signer, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)

    ca, server = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
    (folder / "ca.pem").write_bytes(certificate("ca", ca, ca, True))
    (folder / "server.pem").write_bytes(certificate("server", server, ca, False))
    form = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    (folder / "server.key").write_bytes(server.private_bytes(serialization.Encoding.PEM, *form))


@needs_mosquitto
def test_tls_with_user_and_password(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    certificates(tmp_path)
    users = tmp_path / "users"
    subprocess.run(["mosquitto_passwd", "-b", "-c", str(users), "anna", "s3cret"], check=True, capture_output=True)
    files = [f"{key} {tmp_path / name}" for key, name in (("certfile", "server.pem"), ("keyfile", "server.key"))]
    with (
        Broker(tmp_path, *files, "user root", f"password_file {users}") as broker,
        Listener(broker.port, "#", user="anna", password="s3cret", ca=tmp_path / "ca.pem") as listener,
    ):
        monkeypatch.setenv("BROKER_PASSWORD", "wrong")
        path = boiler(tmp_path, broker.port, ", user: anna, password: env:BROKER_PASSWORD, tls: ca.pem")
        with VirtualRun(path) as run:
            run.run_for("1500 ms")
            (problem,) = run.problems
            assert f": the broker 127.0.0.1:{broker.port} refuses: Not authorized, " in problem
            assert problem.endswith(" wait")
        (tmp_path / "secret").write_text("s3cret\n")
        path = boiler(tmp_path, broker.port, ", user: anna, password: file:secret, tls: ca.pem")
        with VirtualRun(path) as run:
            run.run_for("1500 ms")
            assert run.problems == []
        listener.wait(lambda: len(listener.of("framekit/boiler/temperature")) == 2)  # the first waited
        path = boiler(tmp_path, broker.port, ", user: anna, password: file:secret, tls: yes")
        with VirtualRun(path) as run:
            run.run_for("100 ms")
            assert "certificate verify failed" in run.problems[0]
    assert "s3cret" not in caplog.text


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        (", password: env:P", "a password without a user has no effect – add user:"),
        (
            ", user: a, password: s3cret",
            "a secret does not stand in a run file – write env:NAME for the environment, or file:NAME",
        ),
        (", topic: a/b", "all points would have one topic – write {point} into it"),
        (', topic: "a/{pint}"', "'{pint}' is no part of a topic – known: {run}, {point}"),
        (', topic: "a/#/{point}"', "'a/#/{point}' is no topic – write it like plant/{run}/{point}"),
        (", points: temp*, tls: none.pem", "there is no file 'none.pem' – write yes, or a file of certificates (PEM)"),
        (", most: 0", "nothing could wait – give 1 or more, or leave most out"),
    ],
)
def test_what_is_wrong_with_it(tmp_path: Path, more: str, problem: str) -> None:
    with pytest.raises(DefinitionError) as error:
        loaded(boiler(tmp_path, 1883, more))
    assert [str(problem).partition(": ")[2] for problem in error.value.problems] == [problem]
    assert "s3cret" not in str(error.value)


def test_each_topic_has_one_meaning(tmp_path: Path) -> None:
    todo = "write another topic or status, or give the point another name"
    for more, text in (
        (', status: "framekit/{run}/mode"',
         "the status of the run and the point mode would have one topic, framekit/{run}/mode"),
        (', status: "framekit/{run}/mode/set/answer", commands: yes',
         "the status of the run and the answers of point mode would have one topic, framekit/{run}/mode/set/answer"),
    ):  # fmt: skip
        with pytest.raises(DefinitionError) as error:
            loaded(boiler(tmp_path, 1883, more))
        assert [str(problem).partition(": ")[2] for problem in error.value.problems] == [f"{text} – {todo}"]
    path = boiler(tmp_path, 1883)
    path.write_text(path.read_text("utf-8").replace("  mode:", "  status:"), "utf-8")
    with pytest.raises(DefinitionError, match="the status of the run and the point status would have one topic"):
        loaded(path)
    loaded(boiler(tmp_path, 1883, ', status: "framekit/{run}/mode", points: temp*'))
    loaded(boiler(tmp_path, 1883, ', status: "framekit/{run}/mode/set"'))
    with VirtualRun(boiler(tmp_path, 1883, ', status: "framekit/boiler/mode"')) as run:
        assert "would have one topic, framekit/boiler/mode" in run.problems[0]


def test_each_point_of_each_run_has_a_name_of_its_own() -> None:
    runs, points = ("a", "a_b", "a.b", "a-b"), ("b", "c", "a.b", "a_b", "a._b", "a_.b", "a-b", "b_c", "ä", "a-2eb")
    ids = {f"{_as_id(run, '')}_{_as_id(point, '_')}" for run in runs for point in points}
    assert len(ids) == len(runs) * len(points)
    assert all(set(identifier) <= set(_PLAIN + "_-") for identifier in ids)
    assert _as_id("set_point2", "_") == "set_point2"


def test_no_point_to_write_no_address_and_one_store_for_two(tmp_path: Path) -> None:
    for sinks, problem in (
        (["{mqtt: there, commands: yes}"], "no point can be written"),
        (['{mqtt: "a:b:c"}'], "'a:b:c' is no address of a broker"),
        (["{mqtt: here}", "{mqtt: there}"], "'plant.mqtt.db' is the file of a sink in line 8 already – give store: a"),
    ):
        with pytest.raises(DefinitionError, match=problem):
            loaded(run_file(tmp_path, *sinks))


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"{}",
        b"[1]",
        b"null",
        b"[" * 60_000,
        b"x" * 70_000,
        b"\xff",
        b'{"value": NaN}',
        b"1e999",
        b"-1e999",
        b'{"value": 1e999}',
        b'{"value": 1, "id": 1e999}',
        b'{"value": 1, "id": true}',
        b'{"value": 1, "id": ' + b"[" * 900 + b"]" * 900 + b"}",
    ],
)
def test_what_is_no_command(payload: bytes) -> None:
    try:
        value, _ = parsed(payload)
    except ValueError:
        return
    assert isinstance(value, str)  # a text, which no number takes
