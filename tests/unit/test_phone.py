"""The page that shows an EIA on a phone, and its server: this page, one address, nothing else."""

import base64
import http.client
import re
import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image

from inim.errors import UsageError
from inim.views import phone
from inim.views.phone import PageServer, own_address, phone_page, serve


@pytest.fixture
def server() -> Iterator[PageServer]:
    with PageServer("<p>an EIA</p>", "127.0.0.1") as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def answer(server: PageServer, path: str, method: str = "GET") -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)
    connection.request(method, path)
    response = connection.getresponse()
    return response.status, response.read()


def test_page_holds_each_pixel_of_the_eia(tmp_path):
    codes = np.random.default_rng(0).integers(0, 256, (6, 9, 3), np.uint8)
    Image.fromarray(codes).save(tmp_path / "an & eia.png")
    page = phone_page(tmp_path / "an & eia.png")
    (source,) = re.findall(r'src="data:image/png;base64,([^"]*)"', page)
    (tmp_path / "shown.png").write_bytes(base64.b64decode(source))
    assert (np.asarray(Image.open(tmp_path / "shown.png")) == codes).all()
    assert "an &amp; eia" in page and "@" not in re.sub(r'src="[^"]*"', "", page)
    assert not re.findall(r'(?:src|href)="(?!data:)', page)


def test_server_gives_its_page_at_its_address_and_nothing_else(server):
    path = server.url.partition(str(server.server_address[1]))[2]
    assert answer(server, path) == (200, b"<p>an EIA</p>")
    for other in ("/", path + "/", path[:-1], f"{path}/../../etc/passwd", "/etc/passwd", "*"):
        status, body = answer(server, other)
        assert status == 404 and b"EIA" not in body, other
    assert answer(server, path, "POST")[0] == 501
    assert answer(server, path, "PUT")[0] == 501


def test_addresses_of_two_servers_differ_and_are_on_this_machine_only():
    with PageServer("", "127.0.0.1") as a, PageServer("", "127.0.0.1") as b:
        assert a.path != b.path and len(a.path) >= 12
        assert a.server_address[0] == "127.0.0.1"


def test_address_of_another_machine_is_refused():
    with pytest.raises(UsageError, match=r"--serve 192\.0\.2\.7: this machine has no such address"):
        PageServer("", "192.0.2.7")


def test_own_address_is_one_that_a_server_can_have():
    try:
        address = own_address()
    except UsageError as error:
        assert "no network" in str(error)
        return
    with PageServer("", "lan") as server:
        assert server.url.startswith(f"http://{address}:")


def test_address_is_printed_with_a_code_until_an_interrupt(monkeypatch):
    def interrupted(_: PageServer) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(PageServer, "serve_forever", interrupted)
    lines: list[str] = []
    serve("", "127.0.0.1", lines.append)
    assert re.search(r"http://127\.0\.0\.1:\d+/", lines[0]) and "█" in lines[0]
    assert lines[-1] == "ended"
    monkeypatch.setitem(sys.modules, "segno", None)
    assert "pip install 'inim[serve]'" in phone._qr_code("http://127.0.0.1:1/")
