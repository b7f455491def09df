"""Ciphers as wraps and keyed check codes: published vectors, wrong tags, and keys that appear in no output.

The construct compiler (`construct_oracle/keyed.py`) computes everything from single blocks; drawn definitions and
segment cases compare it with the generated functions.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest
from construct_oracle import compile_construct

from framekit.api.check import check_file
from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.times import parse_format
from framekit.link.events import Seen
from framekit.link.listener import Listener
from framekit.link.variables import ParameterError, given_value

COMPILERS = {"python": compile_protocol, "construct": compile_construct}
PLAIN = (
    "6BC1BEE22E409F96E93D7E117393172AAE2D8A571E03AC9C9EB76FAC45AF8E51"
    "30C81C46A35CE411E5FBC1191A0A52EFF69F2445DF4F9B17AD2B417BE66C3710"
)
"""The four blocks of NIST SP 800-38A, F, and of RFC 4493, 4."""
KEY_128 = "2B7E151628AED2A6ABF7158809CF4F3C"
KEY_192 = "8E73B0F7DA0E6452C810F32B809079E562F8EAD2522C6B7B"
KEY_256 = "603DEB1015CA71BE2B73AEF0857D77811F352C073B6108D72D9810A30914DFF4"
COUNTER = "F0F1F2F3F4F5F6F7F8F9FAFBFCFDFEFF"
INITIAL = "000102030405060708090A0B0C0D0E0F"

NIST = {
    "SP 800-38A, F.2.1, CBC-AES128": ("aes-cbc", KEY_128, INITIAL,
        "7649ABAC8119B246CEE98E9B12E9197D5086CB9B507219EE95DB113A917678B2"
        "73BED6B8E3C1743B7116E69E222295163FF1CAA1681FAC09120ECA307586E1A7"),
    "SP 800-38A, F.2.3, CBC-AES192": ("aes-cbc", KEY_192, INITIAL,
        "4F021DB243BC633D7178183A9FA071E8B4D9ADA9AD7DEDF4E5E738763F69145A"
        "571B242012FB7AE07FA9BAAC3DF102E008B0E27988598881D920A9E64F5615CD"),
    "SP 800-38A, F.2.5, CBC-AES256": ("aes-cbc", KEY_256, INITIAL,
        "F58C4C04D6E5F1BA779EABFB5F7BFBD69CFC4E967EDB808D679F777BC6702C7D"
        "39F23369A9D9BACFA530E26304231461B2EB05E2C39BE9FCDA6C19078C6A9D1B"),
    "SP 800-38A, F.5.1, CTR-AES128": ("aes-ctr", KEY_128, COUNTER,
        "874D6191B620E3261BEF6864990DB6CE9806F66B7970FDFF8617187BB9FFFDFF"
        "5AE4DF3EDBD5D35E5B4F09020DB03EAB1E031DDA2FBE03D1792170A0F3009CEE"),
    "SP 800-38A, F.5.3, CTR-AES192": ("aes-ctr", KEY_192, COUNTER,
        "1ABC932417521CA24F2B0459FE7E6E0B090339EC0AA6FAEFD5CCC2C6F4CE8E94"
        "1E36B26BD1EBC670D1BD1D665620ABF74F78A7F6D29809585A97DAEC58C6B050"),
    "SP 800-38A, F.5.5, CTR-AES256": ("aes-ctr", KEY_256, COUNTER,
        "601EC313775789A5B7A7F504BBF3D228F443E3CA4D62B59ACA84E990CACAF5C5"
        "2B0930DAA23DE94CE87017BA2D84988DDFC9C58DB67AADA613C2DD08457941A6"),
}  # fmt: skip

GCM_KEY = "FEFFE9928665731C6D6A8F9467308308"
GCM_PLAIN = (
    "D9313225F88406E5A55909C5AFF5269A86A7A9531534F7DA2E4C303D8A318A72"
    "1C3C0C95956809532FCF0E2449A6B525B16AEDF5AA0DE657BA637B39"
)
GCM_ALSO = "FEEDFACEDEADBEEFFEEDFACEDEADBEEFABADDAD2"
GCM = {
    "test case 1": ("00" * 16, "00" * 12, "", "", "", "58E2FCCEFA7E3061367F1D57A4E7455A"),
    "test case 2": ("00" * 16, "00" * 12, "00" * 16, "",
        "0388DACE60B6A392F328C2B971B2FE78", "AB6E47D42CEC13BDF53A67B21257BDDF"),
    "test case 4": (GCM_KEY, "CAFEBABEFACEDBADDECAF888", GCM_PLAIN, GCM_ALSO,
        "42831EC2217774244B7221B784D0D49CE3AA212F2C02A4E035C17E2329ACA12E"
        "21D514B25466931C7D8F6A5AAC84AA051BA30B396A0AAC973D58E091", "5BC94FBC3221A5DB94FAE95AE7121A47"),
    "test case 5": (GCM_KEY, "CAFEBABEFACEDBAD", GCM_PLAIN, GCM_ALSO,
        "61353B4C2806934A777FF51FA22A4755699B2A714FCDC6F83766E5F97B6C7423"
        "73806900E49F24B22B097544D4896B424989B5E1EBAC0F07C23F4598", "3612D2E79E3B0785561BE14AACA2FCCB"),
}  # fmt: skip
"""Vectors of McGrew and Viega, The Galois/Counter Mode of Operation, appendix B."""

CMAC = {
    0: "BB1D6929E95937287FA37D129B756746",
    16: "070A16B46B4D4144F79BDD9DD04A287C",
    40: "DFA66747DE9AE63030CA32611497C827",
    64: "51F0BEBF7E3B9D92FC49741779363CFE",
}
"""RFC 4493, 4: code by number of bytes."""

HMAC = {
    "RFC 2202, 2, case 2": ("hmac-md5", b"Jefe", b"what do ya want for nothing?", "750C783E6AB0B503EAA86E310A5DB738"),
    "RFC 2202, 3, case 1": ("hmac-sha1", b"\x0b" * 20, b"Hi There", "B617318655057264E28BC0B6FB378C8EF146BE00"),
    "RFC 4231, 4.2, SHA-224": ("hmac-sha224", b"\x0b" * 20, b"Hi There",
        "896FB1128ABBDF196832107CD49DF33F47B4B1169912BA4F53684B22"),
    "RFC 4231, 4.2, SHA-256": ("hmac-sha256", b"\x0b" * 20, b"Hi There",
        "B0344C61D8DB38535CA8AFCEAF0BF12B881DC200C9833DA726E9376C2E32CFF7"),
    "RFC 4231, 4.2, SHA-384": ("hmac-sha384", b"\x0b" * 20, b"Hi There",
        "AFD03944D84895626B0825F4AB46907F15F9DADBE4101EC682AA034C7CEBC59CFAEA9EA9076EDE7F4AF152E8B2FA9CB6"),
    "RFC 4231, 4.2, SHA-512": ("hmac-sha512", b"\x0b" * 20, b"Hi There",
        "87AA7CDEA5EF619D4FF0B4241A1D6CB02379F4E2CE4EC2787AD0B30545E17CDE"
        "DAA833B7D6B8A702038B274EAEA3F4E4BE9D914EEB61F1702E696C203A126854"),
    "RFC 4231, 4.3, SHA-256": ("hmac-sha256", b"Jefe", b"what do ya want for nothing?",
        "5BDCC146BF60754E6A042426089575C75A003F089D2739839DEC58B964EC3843"),
    "RFC 4231, 4.6, SHA-256, cut to 128 bits": ("hmac-sha256", b"\x0c" * 20, b"Test With Truncation",
        "A3B6167473100EE06E0C796C2955552B"),
    "RFC 4231, 4.6, SHA-512, cut to 128 bits": ("hmac-sha512", b"\x0c" * 20, b"Test With Truncation",
        "415FAD6271580A531D4179BC891D87A6"),
    "RFC 4231, 4.7, SHA-256": ("hmac-sha256", b"\xaa" * 131, b"Test Using Larger Than Block-Size Key - Hash Key First",
        "60E431591EE0B67F0D8A26AACBF5B77F8E0BC6213728C5140546040F0EE37F54"),
}  # fmt: skip


def compiled(body: str, compiler: str, top: str = "") -> Any:
    return COMPILERS[compiler](load_protocol_text(f"protocol: case\n{top}frames:\n  f:\n    body: [{body}]\n"))


def same_both_ways(codec: Any, data: bytes, wire: bytes) -> None:
    assert codec.encode("f", {"d": data}).hex() == wire.hex()
    assert codec.decode("f", wire) == {"d": data}


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("source", NIST)
def test_ciphers_by_nist(source: str, compiler: str) -> None:
    cipher, key, iv, wire = NIST[source]
    wrap = f"{{cipher: {cipher}, key: \"h'{key}'\", iv: \"h'{iv}'\"}}"
    codec = compiled(f"{{wrap: {wrap}, of: [{{data: d, size: rest}}]}}", compiler)
    same_both_ways(codec, bytes.fromhex(PLAIN), bytes.fromhex(wire))


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("source", GCM)
def test_gcm_by_its_specification(source: str, compiler: str) -> None:
    key, iv, plain, also, wire, tag = GCM[source]
    more = f", also: \"h'{also}'\"" if also else ""
    wrap = f"{{cipher: aes-gcm, key: \"h'{key}'\", iv: \"h'{iv}'\"{more}}}"
    codec = compiled(f"{{wrap: {wrap}, of: [{{data: d, size: rest}}]}}", compiler)
    same_both_ways(codec, bytes.fromhex(plain), bytes.fromhex(wire + tag))


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("size", CMAC)
def test_cmac_by_rfc_4493(size: int, compiler: str) -> None:
    codec = compiled(f"{{data: d, size: {size}}}, {{check: cmac-aes, key: \"h'{KEY_128}'\"}}", compiler)
    data = bytes.fromhex(PLAIN)[:size]
    same_both_ways(codec, data, data + bytes.fromhex(CMAC[size]))


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("source", HMAC)
def test_hmac_by_its_rfcs(source: str, compiler: str) -> None:
    method, key, data, code = HMAC[source]
    check = f"{{check: {method}, key: \"h'{key.hex()}'\", size: {len(code) // 2}}}"
    same_both_ways(compiled(f"{{data: d, size: {len(data)}}}, {check}", compiler), data, data + bytes.fromhex(code))


# ---- keys ----------------------------------------------------------------------------------------------------

SECRET = bytes.fromhex("5EC12E75EC12E75EC12E75EC12E75EC1")
BODY = (
    "{data: iv, size: 16}, {length: n, type: u8, of: [w]}, "
    "{name: w, wrap: {cipher: aes-cbc, key: k, iv: iv, pad: pkcs7}, size: n, of: [{data: d, size: rest}]}, "
    "{check: cmac-aes, key: k, size: 4}"
)
TOP = "params: {k: {type: bytes, size: 16, secret: yes}}\n"


def shows_key(text: str) -> bool:
    plain = text.upper().replace(" ", "").replace("\\X", "")
    return SECRET.hex().upper() in plain or repr(SECRET) in text


@pytest.mark.parametrize("compiler", COMPILERS)
def test_every_single_wrong_bit_is_a_bad_frame_that_shows_no_key(compiler: str) -> None:
    codec = compiled(BODY, compiler, TOP)
    names = {"k": SECRET}
    wire = codec.encode("f", {"iv": bytes(range(16)), "d": b"a reading"}, names)
    assert codec.decode("f", wire, names)["d"] == b"a reading"
    for place in [*range(16), *range(17, len(wire))]:  # all bytes except the length
        damaged = bytearray(wire)
        damaged[place] ^= 1 << place % 8
        with pytest.raises(FrameError) as caught:
            codec.decode("f", bytes(damaged), names)
        assert caught.value.cause == "check" and not shows_key(str(caught.value))
        assert "the code made with the key" in str(caught.value)


@pytest.mark.parametrize("piece", [1, 7, 1000])
@pytest.mark.parametrize("key", [SECRET, None, bytes(16)])
def test_a_listener_shows_plain_content_where_it_knows_the_key(key: bytes | None, piece: int) -> None:
    """Three frames, the second with a wrong code: good frames are decoded, the other is a bad frame with its reason."""
    protocol = load_protocol_text(f"protocol: case\n{TOP}frames: {{f: {{body: [{{const: 7E}}, {BODY}]}}}}\n")
    codec = compile_protocol(protocol)
    frames = [codec.encode("f", {"iv": bytes(range(16)), "d": d}, {"k": SECRET}) for d in (b"one", b"two", b"three")]
    frames[1] = frames[1][:-1] + bytes((frames[1][-1] ^ 1,))
    seen: list[Seen] = []
    params = {} if key is None else {"k": key}
    listener = Listener(protocol, codec, seen.append, line=parse_format("8N1", 9600), params=params)
    now, data = 0, b"".join(frames)
    for start in range(0, len(data), piece):
        now += 1_041_667 * len(data[start : start + piece])
        listener.receive(data[start : start + piece], now, (), "in")
    listener.tick(now + 1_000_000_000)
    assert not any(shows_key(repr(event)) for event in seen)
    kinds = [event.kind for event in seen]
    if key == SECRET:
        assert kinds == ["frame", "bad", "frame"] and "check" in str(seen[1])
        assert [event.fields["d"] for event in seen if event.kind == "frame"] == [b"one", b"three"]
    else:
        assert "frame" not in kinds and "bad" in kinds


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("key", [None, b"", b"short", 5, SECRET[:15]])
def test_a_key_that_is_none_is_told_and_not_shown(key: Any, compiler: str) -> None:
    codec = compiled(BODY, compiler, TOP)
    names = {"k": key}
    wire = codec.encode("f", {"iv": bytes(16), "d": b"a"}, {"k": SECRET})
    with pytest.raises(FrameError) as caught:
        codec.decode("f", wire, names)
    assert caught.value.cause == "value"
    with pytest.raises((EncodeError, KeyError)) as refused:
        codec.encode("f", {"iv": bytes(16), "d": b"a"}, names)
    assert "short" not in str(refused.value).replace("too short", "")


def test_a_parameter_that_is_secret_is_refused_without_its_value() -> None:
    protocol = load_protocol_text(f"protocol: case\n{TOP}frames: {{f: {{body: [{BODY}]}}}}\n")
    for wrong in ("5EC12E75EC12E75EC12E75EC12E75EC1zz", "5EC12E7", SECRET * 2, 0x5EC12E75EC12E75EC12E75EC12E75EC1):
        with pytest.raises(ParameterError) as caught:
            given_value(protocol.params["k"], wrong)
        assert "5EC12E7" not in str(caught.value) and not shows_key(str(caught.value))


def test_check_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """If the library is missing."""
    find = importlib.util.find_spec
    monkeypatch.setattr(
        "framekit.definition.model.checks.find_spec", lambda name: None if name == "cryptography" else find(name)
    )
    path = tmp_path / "case.yaml"
    path.write_text(f"protocol: case\n{TOP}frames:\n  f:\n    body: [{BODY}]\n")
    messages = [str(problem).removeprefix(f"{path}:") for problem in check_file(str(path)).problems]
    assert messages == [
        f"5:{5 + text.index(what)}: {name} needs the library cryptography, which is not installed – "
        "install it: pip install cryptography"
        for text in [f"    body: [{BODY}]"[4:]]
        for what, name in (("{cipher", "aes-cbc"), ("{check", "cmac-aes"))
    ]
    hashes = tmp_path / "hashes.yaml"
    hashes.write_text(
        "protocol: h\nframes:\n  f:\n    body: [{data: d, size: 2}, {check: hmac-sha256, key: \"h'01'\"}]\n"
    )
    assert not check_file(str(hashes)).problems, "HMAC takes the standard library"


def test_generated_modules_carry_ciphers_along() -> None:
    """Standalone code imports the library, and holds no key."""
    from framekit.codec.python.generate import generate_source

    text = generate_source(load_protocol_text(f"protocol: case\n{TOP}frames: {{f: {{body: [{BODY}]}}}}\n"))
    module: dict[str, Any] = {}
    exec(compile(text, "<generated>", "exec"), module)
    wire = module["encode_f"]({"iv": bytes(16), "d": b"a"}, {"k": SECRET})
    assert module["decode_f"](wire, {"k": SECRET})["d"] == b"a"
    assert "import framekit" not in text and "from framekit" not in text


@pytest.mark.parametrize("form", ["", ", as: hex", ", as: nibbles, order: little"])
@pytest.mark.parametrize("ends", ["", ", ends: yes"])
def test_codes_made_with_a_key_are_compared_in_constant_time(
    form: str, ends: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every comparison (reading, measuring, diagnosing) calls `compare_digest` with the whole code."""
    import hmac

    body = f"{{data: d, size: 2}}, {{check: cmac-aes, key: k, size: 8{form}{ends}}}, {{data: e, size: 2}}"
    codec = compiled(body, "python", TOP)
    names = {"k": SECRET}
    wire = codec.encode("f", {"d": b"ab", "e": b"cd"}, names)
    seen: list[tuple[int, bool]] = []
    compare = hmac.compare_digest

    def counted(found: bytes, wanted: bytes) -> bool:
        seen.append((len(found), compare(found, wanted)))
        return seen[-1][1]

    monkeypatch.setattr("hmac.compare_digest", counted)
    assert codec.decode("f", wire, names) == {"d": b"ab", "e": b"cd"}
    assert seen == [(8 // (2 if form else 1), True)]
    if ends:
        codec.measure("f", wire, 0, len(wire), names, 0)
        assert len(seen) == 2
    with pytest.raises(FrameError):
        codec.decode("f", wire[:2] + bytes((wire[2] ^ 1,)) + wire[3:], names)
    assert (8 // (2 if form else 1), False) in seen
