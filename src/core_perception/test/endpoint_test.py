# SPDX-License-Identifier: BSD-3-Clause
import pytest

from core_perception.endpoint import Endpoint, load_allowed_hosts
from core_perception.exceptions import EndpointError


@pytest.mark.parametrize(
    ("url", "host", "port", "base_path"),
    [
        ("http://127.0.0.1:11434", "127.0.0.1", 11434, ""),
        ("http://127.8.9.10:1", "127.8.9.10", 1, ""),
        ("http://[::1]:8080/", "::1", 8080, ""),
        ("http://LOCALHOST", "localhost", 80, ""),
        ("https://localhost/proxy/v1/", "localhost", 443, "/proxy/v1"),
    ],
)
def test_this_machine_is_allowed_by_default(url, host, port, base_path):
    endpoint = Endpoint.parse(url)
    assert (endpoint.host, endpoint.port, endpoint.base_path) == (host, port, base_path)
    assert endpoint.is_loopback
    assert Endpoint.parse(endpoint.url) == endpoint


@pytest.mark.parametrize(
    "url",
    [
        "http://10.0.0.5:11434",
        "https://models.example.org",
        "http://0.0.0.0:11434",
        "http://127.1:11434",
        "http://2130706433",
        "http://0x7f000001",
        "http://127.0.0.1.example.org",
        "http://localhost.example.org",
        "http://[::ffff:10.0.0.5]:11434",
        "http://[fe80::1]:11434",
    ],
)
def test_another_host_is_refused_by_default(url):
    with pytest.raises(EndpointError, match="not on this machine"):
        Endpoint.parse(url)


@pytest.mark.parametrize(
    "url",
    [
        "",
        "127.0.0.1:11434",
        "ftp://127.0.0.1",
        "http://",
        "http://:80",
        "http://127.0.0.1:0",
        "http://127.0.0.1:65536",
        "http://127.0.0.1:port",
        "http://[::1",
        "http://127.0.0.1?model=x",
        "http://127.0.0.1#part",
        "http://127.0.0.1/?",
        "http://127.0.0.1/a b",
        "http://127.0.0.1/a//b",
        "http://127.0.0.1/%2e",
        "http://127.0.0.1\r\nX-Header: 1",
        "http://127.0.0.1\\.example.org",
        "http://ma\u0457n.example.org",
        "http://a_b!c",
        "http://127.0.0.1/" + "a" * 5000,
        None,
        7,
    ],
)
def test_a_malformed_address_is_refused_in_one_line(url):
    with pytest.raises(EndpointError) as caught:
        Endpoint.parse(url, allow_remote_images=True)
    assert "\n" not in str(caught.value)
    assert 20 < len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "url", ["http://me:s3cret@127.0.0.1", "http://127.0.0.1@models.example.org", "http://k3y@[::1]"]
)
def test_credentials_in_the_address_are_refused_and_not_repeated(url):
    with pytest.raises(EndpointError) as caught:
        Endpoint.parse(url)
    assert not any(secret in str(caught.value) for secret in ("s3cret", "k3y", "me:"))


def allow(tmp_path, *lines):
    path = tmp_path / "hosts"
    path.write_text("\n".join(lines) + "\n")
    return load_allowed_hosts(path)


def test_a_listed_host_needs_allow_remote_images_too(tmp_path):
    allowed = allow(tmp_path, "models.example.org")
    assert Endpoint.parse("https://models.example.org", allowed, True).port == 443
    with pytest.raises(EndpointError, match="allow_remote_images"):
        Endpoint.parse("https://models.example.org", allowed, False)


def test_allow_remote_images_needs_a_listed_host_too(tmp_path):
    allowed = allow(tmp_path, "other.example.org")
    with pytest.raises(EndpointError, match="list of allowed hosts"):
        Endpoint.parse("https://models.example.org", allowed, True)


@pytest.mark.parametrize(
    ("line", "url", "is_allowed"),
    [
        ("gpu.example.org", "https://gpu.example.org:9000", True),
        ("gpu.example.org", "http://gpu.example.org:9000", False),
        ("gpu.example.org:8000", "https://gpu.example.org:8000", True),
        ("gpu.example.org:8000", "https://gpu.example.org", False),
        ("http://gpu.example.org", "http://gpu.example.org:9000", True),
        ("http://gpu.example.org:8000", "http://gpu.example.org:8000", True),
        ("http://gpu.example.org:8000", "http://gpu.example.org:8001", False),
        ("http://gpu.example.org", "https://gpu.example.org", True),
        ("https://gpu.example.org", "http://gpu.example.org", False),
        ("GPU.Example.org  # upstairs", "https://gpu.example.org", True),
        ("# gpu.example.org", "https://gpu.example.org", False),
        ("[fd00::7]:8000", "https://[fd00::7]:8000", True),
        ("fd00.example.org", "https://sub.fd00.example.org", False),
    ],
)
def test_a_line_allows_what_it_says_and_no_more(tmp_path, line, url, is_allowed):
    allowed = allow(tmp_path, "", line)
    if is_allowed:
        assert not Endpoint.parse(url, allowed, True).is_loopback
    else:
        with pytest.raises(EndpointError):
            Endpoint.parse(url, allowed, True)


@pytest.mark.parametrize("line", ["a b", "host:0", "host:99999", "ftp://host", "host/path", "user@host", "*"])
def test_a_malformed_line_is_refused_with_its_number(tmp_path, line):
    with pytest.raises(EndpointError, match="line 2"):
        allow(tmp_path, "good.example.org", line)


def test_a_missing_list_is_refused(tmp_path):
    with pytest.raises(EndpointError, match="cannot be read"):
        load_allowed_hosts(tmp_path / "absent")


def test_a_first_folder_that_the_base_path_ends_with_is_not_repeated():
    plain, v1 = Endpoint.parse("http://127.0.0.1"), Endpoint.parse("http://127.0.0.1/team/v1")
    assert plain.request_path("/v1/models") == "/v1/models"
    assert v1.request_path("/v1/models") == "/team/v1/models"
    assert v1.request_path("/api/chat") == "/team/v1/api/chat"


def test_a_local_name_may_only_resolve_to_this_machine(tmp_path):
    local = Endpoint.parse("http://localhost:1")
    assert local.allows_address("127.0.0.1")
    assert local.allows_address("::1")
    assert not local.allows_address("10.0.0.5")
    remote = Endpoint.parse("https://gpu.example.org", allow(tmp_path, "gpu.example.org"), True)
    assert remote.allows_address("10.0.0.5")
