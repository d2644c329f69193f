"""A page that shows an EIA on a phone, pixel by pixel, and a server for this page alone.

The server answers one path, which contains random words, and runs until it is interrupted.
"""

from __future__ import annotations

import base64
import html
import io
import secrets
import socket
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from PIL import Image

from inim.errors import UsageError
from inim.files.eia_file import eia_codes

#: Word for the machine's address in its network.
LAN = "lan"
# An address of the documentation's range (RFC 5737): the route to it names the own address.
_ELSEWHERE = ("192.0.2.1", 9)
_TIMEOUT_S = 30


def phone_page(eia: Path) -> str:
    """Self-contained page that shows an EIA with one panel pixel for each of its pixels.

    Raises `FileError`: missing, damaged or wrong format.
    """
    codes = eia_codes(eia)
    buffer = io.BytesIO()
    Image.fromarray(codes).save(buffer, "PNG")
    rows, columns = codes.shape[:2]
    values = {
        "TITLE": html.escape(eia.stem),
        "COLUMNS": str(columns),
        "ROWS": str(rows),
        "SOURCE": "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode(),
    }
    page = Path(__file__).with_name("phone.html").read_text("utf-8")
    for name, value in values.items():
        page = page.replace(f"@{name}@", value)
    return page


class PageServer(ThreadingHTTPServer):
    """Server of one page; `url` is its address.

    * `address`: `LAN`, or the host to listen on, such as 127.0.0.1.

    Raises `UsageError`: this machine has no such address.
    """

    daemon_threads = True

    def __init__(self, page: str, address: str) -> None:
        self.page = page.encode()
        self.path = f"/{secrets.token_urlsafe(9)}"
        host = own_address() if address == LAN else address
        try:
            super().__init__((host, 0), _Handler)
        except OSError as error:
            raise UsageError(
                f"--serve {address}: this machine has no such address ({error.strerror or error}); "
                f"leave it out, or use {LAN}"
            ) from None
        self.url = f"http://{host}:{self.server_address[1]}{self.path}"


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = _TIMEOUT_S
    server_version = "inim"
    sys_version = ""

    def do_GET(self) -> None:
        if not secrets.compare_digest(self.path.encode(), self.server.path.encode()):
            self.send_error(404)
            return
        self.send_response(200)
        for name, value in {
            "Content-Type": "text/html; charset=utf-8",
            "Content-Length": str(len(self.server.page)),
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
        }.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(self.server.page)

    def log_message(self, *_: object) -> None:
        """Log nothing."""


def own_address() -> str:
    """Address of this machine in its network; nothing is sent.

    Raises `UsageError`: it is in no network.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_ELSEWHERE)
        except OSError:
            raise UsageError(f"--serve {LAN}: this machine is in no network") from None
        return str(probe.getsockname()[0])


def serve(page: str, address: str, say: Callable[[str], object]) -> None:
    """Serve a page until an interrupt, and print its address, as a QR code for phones, too."""
    with PageServer(page, address) as server:
        say(f"\n{_qr_code(server.url)}{server.url}\nCtrl+C ends it.")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            say("ended")


def _qr_code(url: str) -> str:
    """QR code in block characters, or a hint at the package that draws it."""
    try:
        import segno
    except ImportError:
        return "(for a QR code: pip install 'inim[serve]')\n"
    text = io.StringIO()
    segno.make(url, micro=False).terminal(out=text, compact=True)
    return text.getvalue()
