"""Access control of the page: only names of this machine, no other web page, and a token for actions."""

from __future__ import annotations

import hmac
import ipaddress
import logging
import secrets
import socket
from collections.abc import Mapping

from framekit.sinks.secrets import secret_named

log = logging.getLogger(__name__)

SHORTEST_TOKEN = 12


class Access:
    """The token of one server.

    `made`: the token was generated, so that it has to be shown to the operator.
    """

    def __init__(self, token: str = "") -> None:
        """Raise ValueError for a token that is too short to be a secret."""
        if token and len(token) < SHORTEST_TOKEN:
            raise ValueError(f"the token has {len(token)} characters – give {SHORTEST_TOKEN} or more")
        self.made = not token
        self.token = token or secrets.token_urlsafe(24)

    def fits(self, given: object) -> bool:
        """Return whether this is the token; the comparison takes constant time."""
        text = given if isinstance(given, str) else ""
        return hmac.compare_digest(text.encode(errors="replace"), self.token.encode(errors="replace"))


class Visitor:
    """A browser at `who`. `may`: it has given the token and may act."""

    def __init__(self, access: Access, who: str) -> None:
        self.who = who
        self.may = False
        self.wrong_tokens = 0
        self._access = access

    def give(self, token: object) -> dict[str, bool]:
        """Check the token of a browser and return the answer."""
        self.may = self._access.fits(token)
        if not self.may:
            self.wrong_tokens += 1
            log.warning("web: %s has given a wrong token", self.who)
        return {"may": self.may}

    def refused(self) -> str:
        """Return the reason why it may not act; '' if it may. A refusal is logged."""
        if self.may:
            return ""
        log.warning("web: refused to %s, who has not given the token", self.who)
        return "only with the token"


def kept_token(text: str) -> str:
    """Return the token at the place that `env:NAME` or `file:NAME` gives. Raises ValueError, OSError."""
    found = secret_named(text, "token").read()
    if not found:
        raise ValueError("there is no token – put one there")
    return found


def is_known_host(host: str) -> bool:
    """Return whether a Host header names this machine: by an address, as localhost, or by its own name.

    A page of another name that was redirected here (DNS rebinding) sends that name.
    """
    name = host_name(host)
    try:
        ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        own = socket.gethostname().lower()
        return name in ("localhost", own, f"{own}.local")
    return True


def host_name(host: str) -> str:
    """Return a host without its port, in lower case."""
    name, colon, port = host.lower().rpartition(":")
    return name if colon and port.isdecimal() else host.lower()


def is_own_origin(headers: Mapping[str, str]) -> bool:
    """Return whether a request comes from this page, or has no origin: browsers send the origin of every other page."""
    origin = headers.get("origin")
    if origin is None:
        return True
    scheme, _, host = origin.partition("://")
    return scheme in ("http", "https") and host.lower() == headers.get("host", "").lower()


HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Headers of every answer: no content from other servers, and no scripts but the page's own."""
