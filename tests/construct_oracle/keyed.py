"""Ciphers and keyed codes, computed from single AES blocks and hash functions as in their standards.

CBC and CTR: NIST SP 800-38A, 6.2 and 6.5. GCM: SP 800-38D, 6 and 7. CMAC: RFC 4493. HMAC: RFC 2104.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace

from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

from framekit.definition.codings import Ciphered


def block(key: bytes, data: bytes) -> bytes:
    """Encrypt a block."""
    run = Cipher(algorithms.AES(key), modes.ECB()).encryptor()
    return bytes(run.update(data))


def block_back(key: bytes, data: bytes) -> bytes:
    """Decrypt a block."""
    run = Cipher(algorithms.AES(key), modes.ECB()).decryptor()
    return bytes(run.update(data))


def xor(first: bytes, second: bytes) -> bytes:
    return bytes(a ^ b for a, b in zip(first, second, strict=False))


def blocks(data: bytes) -> list[bytes]:
    return [data[at : at + 16] for at in range(0, len(data), 16)]


def chained(key: object, data: object, iv: object = bytes(16)) -> bytes:
    """Compute the function `aes`: encrypt whole blocks, each XORed with the previous result. Raises ValueError."""
    if not all(isinstance(argument, bytes) for argument in (key, data, iv)):
        raise ValueError("no bytes")
    assert isinstance(key, bytes) and isinstance(data, bytes) and isinstance(iv, bytes)
    if len(key) not in (16, 24, 32) or len(iv) != 16 or len(data) % 16:
        raise ValueError("no key, no initial value or no whole blocks")
    found, last = b"", iv
    for part in blocks(data):
        last = block(key, xor(part, last))
        found += last
    return found


def counted(key: bytes, first: bytes, data: bytes, bits: int) -> bytes:
    """Encrypt in counter mode: XOR the data with the encrypted counters, which count in their last `bits` bits."""
    number, found = int.from_bytes(first, "big"), b""
    mask = (1 << bits) - 1
    for place, part in enumerate(blocks(data)):
        counter = (number & ~mask) | ((number + place) & mask)
        found += xor(part, block(key, counter.to_bytes(16, "big")))
    return found


def multiplied(x: int, y: int) -> int:
    """Return the product in GF(2^128) of GCM: the first bit is the lowest power."""
    found, shifted = 0, y
    for bit in range(127, -1, -1):
        if x >> bit & 1:
            found ^= shifted
        shifted = shifted >> 1 ^ (0xE1 << 120 if shifted & 1 else 0)
    return found


def ghash(key: bytes, data: bytes) -> bytes:
    h, y = int.from_bytes(block(key, bytes(16)), "big"), 0
    for part in blocks(data):
        y = multiplied(y ^ int.from_bytes(part, "big"), h)
    return y.to_bytes(16, "big")


def filled(data: bytes) -> bytes:
    return data + bytes(-len(data) % 16)


def galois(key: bytes, iv: bytes, also: bytes, data: bytes, encrypt: bool) -> tuple[bytes, bytes]:
    """Encrypt or decrypt in Galois/counter mode; return the output and the full tag."""
    first = iv + b"\0\0\0\1" if len(iv) == 12 else ghash(key, filled(iv) + bytes(8) + (8 * len(iv)).to_bytes(8, "big"))
    start = first[:12] + ((int.from_bytes(first[12:], "big") + 1) & 0xFFFFFFFF).to_bytes(4, "big")
    out = counted(key, start, data, 32)
    sizes = (8 * len(also)).to_bytes(8, "big") + (8 * len(data)).to_bytes(8, "big")
    hashed = ghash(key, filled(also) + filled(out if encrypt else data) + sizes)
    return out, xor(hashed, block(key, first))


def checked(coding: Ciphered, key: object, iv: object, also: object = b"") -> tuple[bytes, bytes, bytes]:
    """Return the values of a cipher. Raises ValueError for values of the wrong type or length."""
    if not isinstance(key, bytes) or not isinstance(iv, bytes) or not isinstance(also, bytes):
        raise ValueError("no bytes")
    if len(key) not in (16, 24, 32):
        raise ValueError("no key")
    if not (8 <= len(iv) <= 128 if coding.cipher == "aes-gcm" else len(iv) == 16):
        raise ValueError("no initial value")
    return key, iv, also


def enciphered(coding: Ciphered, plain: bytes, key: bytes, iv: bytes, also: bytes = b"") -> bytes:
    """Return the wire form of the content. Raises ValueError."""
    if coding.clear:
        if len(plain) < coding.clear:
            raise ValueError("fewer bytes than stand as they are")
        rest = enciphered(replace(coding, clear=0), plain[coding.clear :], key, iv, also)
        return plain[: coding.clear] + rest
    if coding.cipher == "aes-gcm":
        out, tag = galois(key, iv, also, plain, True)
        return out + tag[: coding.tag]
    if coding.cipher == "aes-ctr":
        return counted(key, iv, plain, 128)
    more = 16 - len(plain) % 16
    if coding.pad == "pkcs7":
        plain += bytes([more] * more)
    elif coding.pad == "iso7816":
        plain += b"\x80" + bytes(more - 1)
    elif more != 16:
        raise ValueError("no whole blocks")
    found, last = b"", iv
    for part in blocks(plain):
        last = block(key, xor(part, last))
        found += last
    return found


def deciphered(coding: Ciphered, wire: bytes, key: bytes, iv: bytes, also: bytes = b"") -> tuple[bytes, bytes, bytes]:
    """Return the content, the expected tag and the tag on the wire. Raises ValueError."""
    if coding.clear:
        if len(wire) < coding.clear:
            raise ValueError("fewer bytes than stand as they are")
        plain, *tags = deciphered(replace(coding, clear=0), wire[coding.clear :], key, iv, also)
        return wire[: coding.clear] + plain, tags[0], tags[1]
    if coding.cipher == "aes-gcm":
        if len(wire) < coding.tag:
            raise ValueError("no tag")
        cut = len(wire) - coding.tag
        plain, tag = galois(key, iv, also, wire[:cut], False)
        return plain, tag[: coding.tag], wire[cut:]
    if coding.cipher == "aes-ctr":
        return counted(key, iv, wire, 128), b"", b""
    if len(wire) % 16 or (coding.pad != "none" and not wire):
        raise ValueError("no whole blocks")
    plain, last = b"", iv
    for part in blocks(wire):
        plain += xor(block_back(key, part), last)
        last = part
    if coding.pad == "pkcs7":
        count = plain[-1]
        if not 1 <= count <= 16 or plain[-count:] != bytes([count] * count):
            raise ValueError("wrong padding")
        plain = plain[:-count]
    elif coding.pad == "iso7816":
        cut = plain.rfind(b"\x80")
        if cut < len(plain) - 16 or any(plain[cut + 1 :]):
            raise ValueError("wrong padding")
        plain = plain[:cut]
    return plain, b"", b""


def cmac(key: bytes, data: bytes) -> bytes:
    def doubled(value: bytes) -> bytes:
        number = int.from_bytes(value, "big") << 1
        return ((number & (1 << 128) - 1) ^ (0x87 if number >> 128 else 0)).to_bytes(16, "big")

    first = doubled(block(key, bytes(16)))
    parts = blocks(data) or [b""]
    whole = len(parts[-1]) == 16
    parts[-1] = xor(parts[-1], first) if whole else xor(filled(parts[-1] + b"\x80"), doubled(first))
    last = bytes(16)
    for part in parts:
        last = block(key, xor(part, last))
    return last


def hashed(kind: str, key: bytes, data: bytes) -> bytes:
    digest = getattr(hashlib, kind)
    size = digest().block_size
    key = (digest(key).digest() if len(key) > size else key).ljust(size, b"\0")
    inner = digest(bytes(byte ^ 0x36 for byte in key) + data).digest()
    return bytes(digest(bytes(byte ^ 0x5C for byte in key) + inner).digest())


def code_with_key(kind: str, key: object, data: bytes, size: int) -> int:
    """Return the first bytes of a keyed code as a number. Raises ValueError."""
    if not isinstance(key, bytes):
        raise ValueError("no bytes")
    if kind == "cmac-aes" and len(key) not in (16, 24, 32):
        raise ValueError("no key")
    whole = cmac(key, data) if kind == "cmac-aes" else hashed(kind.removeprefix("hmac-"), key, data)
    return int.from_bytes(whole[:size], "big")
