# SPDX-License-Identifier: BSD-3-Clause
"""The address of a model server, and whether images may be sent there.

This machine is allowed; any other host only if it is written in an allow-list and images may leave the machine at all.
"""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Container, FrozenSet, Optional
from urllib.parse import SplitResult, urlsplit

from core_perception.exceptions import EndpointError

DEFAULT_PORTS = {"http": 80, "https": 443}
HOST_NAME = re.compile(r"(?=.{1,253}\Z)[a-z0-9]([a-z0-9_-]{0,62}\.)*[a-z0-9_-]{0,63}\Z")
BASE_PATH = re.compile(r"(/[A-Za-z0-9._~-]+)*\Z")
LONGEST_URL = 2048


@dataclass(frozen=True)
class Endpoint:
    """Where a server listens.

    Attributes:
        scheme: ``http`` or ``https``.
        host: name or address in lower case, without the brackets of IPv6.
        port: 1 to 65535.
        base_path: what comes before the path of every request; empty or ``/…`` without a last slash.
        allow_remote_images: images may leave this machine.
    """

    scheme: str
    host: str
    port: int
    base_path: str = ""
    allow_remote_images: bool = False

    @classmethod
    def parse(
        cls, url: str, allowed_hosts: Container[str] = frozenset(), allow_remote_images: bool = False
    ) -> Endpoint:
        """Read a URL such as ``http://127.0.0.1:11434``.

        Args:
            url: scheme, host, perhaps port and path; nothing else.
            allowed_hosts: as from load_allowed_hosts: ``host``, ``host:port``, or either behind ``http://``, which
                allows to go there without encryption.
            allow_remote_images: images may leave this machine.

        Raises:
            EndpointError: malformed, or not allowed; never quotes credentials.
        """
        parts, port = _split(url)
        endpoint = cls(parts.scheme, parts.hostname, port, parts.path.rstrip("/"), allow_remote_images)
        if not endpoint.is_loopback:
            endpoint._check_remote(allowed_hosts)
        return endpoint

    @property
    def is_loopback(self) -> bool:
        """The host is called localhost or is a loopback address; what a name resolves to is checked at each connect."""
        return self.host == "localhost" or _is_loopback(self.host)

    @property
    def url(self) -> str:
        """The address in words, for a person."""
        return f"{self.scheme}://{_bracketed(self.host)}:{self.port}{self.base_path}"

    def allows_address(self, address: str) -> bool:
        """Whether a connection may go to an address that the host resolved to."""
        return not self.is_loopback or _is_loopback(address)

    def request_path(self, path: str) -> str:
        """Put base_path before the path of a request; a first folder that base_path ends with is not repeated."""
        first = "/" + path.split("/")[1]
        base = self.base_path[: -len(first)] if self.base_path.endswith(first) else self.base_path
        return base + path

    def _check_remote(self, allowed_hosts: Container[str]):
        names = (_bracketed(self.host), f"{_bracketed(self.host)}:{self.port}")
        if not self.allow_remote_images:
            raise EndpointError(
                f"{self.url} is not on this machine; images leave it only with allow_remote_images: true"
            )
        in_clear = any("http://" + name in allowed_hosts for name in names)
        if not in_clear and not any(name in allowed_hosts for name in names):
            raise EndpointError(f"{self.host} is not in the list of allowed hosts; a line '{names[1]}' would allow it")
        if self.scheme == "http" and not in_clear:
            raise EndpointError(
                f"{self.url} is not encrypted: use https, or a line 'http://{names[1]}' in the list of allowed hosts"
            )


def load_allowed_hosts(path: Path) -> FrozenSet[str]:
    """Read an allow-list: one ``host[:port]`` or ``http://host[:port]`` a line, ``#`` starts a comment.

    Raises:
        EndpointError: the file cannot be read, or a line is malformed.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise EndpointError(f"{path}: cannot be read ({type(error).__name__})") from None
    allowed = set()
    for number, line in enumerate(lines, 1):
        entry = line.split("#")[0].strip().lower()
        if not entry:
            continue
        in_clear = entry.startswith("http://")
        try:
            parts, _ = _split(entry if "://" in entry else "https://" + entry)
        except EndpointError:
            parts = None
        if parts is None or parts.path:
            raise EndpointError(f"{path}, line {number}: a host, host:port or http://host[:port] is wanted")
        name = _bracketed(parts.hostname) + (f":{parts.port}" if parts.port else "")
        allowed.add("http://" + name if in_clear else name)
    return frozenset(allowed)


def _split(url: str):
    """Split a URL and return its parts and its port."""
    if not isinstance(url, str) or not 0 < len(url) <= LONGEST_URL or not url.isascii() or not url.isprintable():
        raise EndpointError("the address of a server is printable ASCII, such as http://127.0.0.1:11434")
    try:
        parts: Optional[SplitResult] = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = None, None
    if parts is None or parts.scheme not in DEFAULT_PORTS or not parts.hostname or port == 0:
        raise EndpointError("the address of a server is http(s)://host[:port][/path]")
    if "@" in parts.netloc:
        raise EndpointError("the address of a server carries no user name or password; keys come from the environment")
    if "?" in url or "#" in url or not BASE_PATH.match(parts.path.rstrip("/")) or "//" in parts.path:
        raise EndpointError("the address of a server has a plain path and neither query nor fragment")
    if not _is_host(parts.hostname):
        raise EndpointError("the host of a server is a name or an IP address")
    return parts, port or DEFAULT_PORTS[parts.scheme]


def _is_host(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return bool(HOST_NAME.match(host))
    return True


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address.split("%")[0]).is_loopback
    except ValueError:
        return False


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
