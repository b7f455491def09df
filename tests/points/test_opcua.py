"""The OPC UA server of a run, with the library's own client: values, qualities, writes, users, certificates."""

from __future__ import annotations

import asyncio
import datetime
import logging
import queue
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from framekit.api.run import Run, loaded
from framekit.definition.problems import DefinitionError

pytest.importorskip("asyncua", reason="asyncua is not installed")

DEVICE = """
device: meter
protocol: modbus-tcp
station: 1
memory: {set: {"40001": [217, 2, 0x4120, 0x0000, 5, 0, 0x7FC0]}}
"""

RUN = """
run: plant
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
points:
  boiler.temperature: {channel: 1, address: "40001", scale: 0.1, unit: °C, every: 100 ms}
  state: {channel: 1, address: "40002", enum: {0: off, 2: heating}}
  setpoint: {channel: 1, address: "40005", access: rw, range: 0..50, every: 100 ms}
  flow: {channel: 1, address: "40006", type: float32}
sinks:
"""


def run_file(folder: Path, sink: str) -> Path:
    (folder / "meter.device.yaml").write_text(DEVICE, "utf-8")
    path = folder / "plant.run.yaml"
    path.write_text(f"{RUN}  - {sink}\n", "utf-8")
    return path


class Ports(logging.Handler):
    """A log handler that records the ports of servers."""

    def __init__(self) -> None:
        super().__init__()
        self.found: queue.Queue[int] = queue.Queue()

    def emit(self, record: logging.LogRecord) -> None:
        self.found.put(int(record.getMessage().rpartition(":")[2]))


@pytest.fixture
def ports() -> Iterator[queue.Queue[int]]:
    log, handler = logging.getLogger("framekit.sinks.opcua"), Ports()
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    yield handler.found
    log.removeHandler(handler)
    log.setLevel(logging.NOTSET)


def with_client(port: int, work: Callable[[Any], Awaitable[None]], **settings: Any) -> None:
    """Run `work` with a connected client."""
    from asyncua import Client

    async def all_of_it() -> None:
        client = Client(f"opc.tcp://127.0.0.1:{port}", timeout=10)
        for name, value in settings.items():
            if name == "security":
                client.application_uri = "urn:client"
                await client.set_security_string(value)
            else:
                getattr(client, f"set_{name}")(value)
        async with client:
            await work(client)

    asyncio.run(all_of_it())


async def value_of(client: Any, name: str, wanted: Callable[[Any], bool]) -> Any:
    """Return the data value of a point as soon as `wanted` accepts it."""
    node = client.get_node(f"ns=2;s={name}")
    for _ in range(2000):
        found = await node.read_data_value(raise_on_bad_status=False)
        if wanted(found):
            return found
        await asyncio.sleep(0)
    raise AssertionError(f"{name} is {found}")


def test_a_client_browses_reads_and_subscribes(tmp_path: Path, ports: queue.Queue[int]) -> None:
    with Run(run_file(tmp_path, "{opcua: 0}")) as run:
        port = ports.get(timeout=60)

        async def work(client: Any) -> None:
            from asyncua import ua

            folder = await client.nodes.objects.get_child("2:plant")
            names = [(await variable.read_browse_name()).Name for variable in await folder.get_variables()]
            assert names == ["boiler.temperature", "state", "setpoint", "flow"]
            found = await value_of(client, "boiler.temperature", lambda one: one.Value.Value == 21.7)
            assert found.Value.VariantType == ua.VariantType.Double and found.StatusCode.is_good()
            assert found.SourceTimestamp is not None
            unit = await client.get_node("ns=2;s=boiler.temperature").get_child("0:EngineeringUnits")
            unit = await unit.read_value()
            assert unit.DisplayName.Text == "°C"
            assert (await value_of(client, "state", lambda one: one.StatusCode.is_good())).Value.Value == "heating"
            bad = await value_of(client, "flow", lambda one: one.StatusCode.value == ua.StatusCodes.Bad)
            assert bad.Value.Value is None
            reason = await (await client.get_node("ns=2;s=flow").get_child("2:Reason")).read_value()
            assert reason == "not a number (NaN)"

            seen: asyncio.Queue[Any] = asyncio.Queue()

            class Hears:
                def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
                    seen.put_nowait(value)

            subscription = await client.create_subscription(10, Hears())
            await subscription.subscribe_data_change(client.get_node("ns=2;s=boiler.temperature"))
            assert await asyncio.wait_for(seen.get(), 10) == 21.7
            run.device("meter").write("40001", [230])
            assert await asyncio.wait_for(seen.get(), 10) == 23.0

        with_client(port, work)


def test_a_client_writes_what_may_be_written(
    tmp_path: Path, ports: queue.Queue[int], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "framekit")
    with Run(run_file(tmp_path, "{opcua: 0}")) as run:
        port = ports.get(timeout=60)

        async def work(client: Any) -> None:
            from asyncua import ua

            setpoint = client.get_node("ns=2;s=setpoint")
            await value_of(client, "setpoint", lambda one: one.Value.Value == 5)
            await setpoint.write_value(ua.DataValue(ua.Variant(33, ua.VariantType.UInt16)))
            await value_of(client, "setpoint", lambda one: one.Value.Value == 33)
            for node, value, wanted in (
                ("setpoint", ua.Variant(99, ua.VariantType.Int64), ua.StatusCodes.BadOutOfRange),
                ("setpoint", ua.Variant([1, 2], ua.VariantType.Int64), ua.StatusCodes.BadTypeMismatch),
                ("state", ua.Variant("off"), ua.StatusCodes.BadNotWritable),
            ):
                with pytest.raises(ua.UaStatusCodeError) as refused:
                    await client.get_node(f"ns=2;s={node}").write_value(ua.DataValue(value))
                assert refused.value.code == wanted
            with pytest.raises(ua.UaStatusCodeError):
                await client.nodes.objects.add_variable(1, "mine", 1)

        with_client(port, work)
        assert run.device("meter").read("40005") == [33]
    messages = [record.getMessage() for record in caplog.records if "by OPC UA" in record.getMessage()]
    assert any("setpoint" in message and "33" in message and "127.0.0.1" in message for message in messages)
    assert any("99 is not in 0..50" in message for message in messages)


def certificate(folder: Path, uri: str) -> tuple[Path, Path]:
    """Write a self-signed certificate, and its key."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import rsa
    from cryptography.x509.oid import NameOID

    secret = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "made for a test")])
    start = datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(secret.public_key())
        .serial_number(1)
        .not_valid_before(start)
        .not_valid_after(start + datetime.timedelta(days=36500))
        .add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri)]), critical=False)
        .sign(secret, hashes.SHA256())
    )
    pem, its_key = folder / f"{uri.replace(':', '-')}.pem", folder / f"{uri.replace(':', '-')}.key.pem"
    pem.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    its_key.write_bytes(
        secret.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
    )
    return pem, its_key


def test_with_a_certificate_only_the_user_comes_in(
    tmp_path: Path, ports: queue.Queue[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPC_PASSWORD", "a good one")
    its, secret = certificate(tmp_path, "urn:framekit:plant")
    own, own_secret = certificate(tmp_path, "urn:client")
    files = f"certificate: {its.name}, private_key: {secret.name}"
    sink = f"{{opcua: 0, {files}, user: operator, password: env:OPC_PASSWORD}}"
    security = f"Basic256Sha256,SignAndEncrypt,{own},{own_secret},{its}"
    with Run(run_file(tmp_path, sink)):
        port = ports.get(timeout=60)
        reached: list[Any] = []

        async def work(client: Any) -> None:
            reached.append((await value_of(client, "boiler.temperature", lambda one: one.Value.Value)).Value.Value)

        with_client(port, work, security=security, user="operator", password="a good one")
        assert reached == [21.7]
        for settings in (
            {"security": security, "user": "operator", "password": "another"},
            {"security": security},
            {"user": "operator", "password": "a good one"},
        ):
            with pytest.raises(Exception, match=r"(?i)denied|identity|token|security|endpoint|policy"):
                with_client(port, work, **settings)
        assert reached == [21.7]


@pytest.mark.parametrize(
    ("sink", "problem"),
    [
        ("{opcua: here}", "'here' is no place to listen on"),
        ("{opcua: 4840, user: operator, password: env:P}", "the password would cross the network"),
        ("{opcua: 4840, user: operator}", "'user' needs 'password'"),
        ("{opcua: 4840, private_key: key.pem}", "'private_key' needs 'certificate'"),
    ],
)
def test_what_is_wrong_with_it(tmp_path: Path, sink: str, problem: str) -> None:
    with pytest.raises(DefinitionError, match=problem):
        loaded(run_file(tmp_path, sink))
