"""Images of a report: read from its folder, compared, and embedded in the page.

Images are embedded so that the page needs no other file. An `Encoding` sets their size. The page
tries the `ENCODINGS` in order; images shown smaller are stored in full in the report's folder.
"""

import base64
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from inim.image.color import linear_from_srgb, magma
from inim.image.files.image import encode_image
from inim.image.files.picture import open_picture
from inim.report.page import element, text, void
from inim.scores.metrics import SSIM_WINDOW, ssim_map
from inim.system.cache import ResultCache, code_digest
from inim.system.errors import FileError

#: Differences are shown this many times brighter: most are below what an eye notices.
DIFFERENCE_GAIN = 4

# Magnified pixels are a whole number of page pixels, and three such images stand side by side.
_CROP_ON_PAGE_PX = 372
_WIDE = 1.5  # images wider than this many times their height get a wider column
_LEFT_OUT = "left out, the page would be too large"


@dataclass(frozen=True)
class Encoding:
    """WebP quality and size of embedded images: `longest_px` 0 omits them."""

    quality: int
    longest_px: int


#: Tried in turn until the page is small enough. The last one always is.
ENCODINGS = (Encoding(90, 640), Encoding(85, 320), Encoding(75, 160), Encoding(0, 0))

# Pillow's options for a WebP image without loss: a third larger would be four times as fast.
_LOSSLESS = {"lossless": True, "quality": 20, "method": 1}
# A WebP image has no longer side.
_LONGEST_WEBP_PX = 16383


@dataclass(frozen=True)
class ReportImages:
    """PNG files of a report's folder, their encoding for the page, and cached encoded images."""

    folder: Path
    encoding: Encoding
    cache: ResultCache = field(default_factory=ResultCache)

    def read(self, *names: str) -> np.ndarray | None:
        """(rows, columns, 3) uint8 sRGB, or None where there is no readable picture.

        Names come from the report; one that leads out of its folder is not followed.
        """
        try:
            path = self.folder.joinpath(*names).resolve()
            if not path.is_relative_to(self.folder.resolve()):
                return None
            with open_picture(path, ("PNG",), 1) as picture:
                return np.asarray(picture.convert("RGB"))
        except (FileError, OSError, ValueError, RuntimeError):  # the latter three of its name
            return None

    def embed(
        self,
        pixels: np.ndarray | None,
        alt: str,
        longest_px: int | None = None,
        *,
        is_measured: bool = False,
        **attributes: object,
    ) -> str:
        """Image element with embedded pixels, or a visible box for a missing image.

        * `is_measured`: the page computes with the pixels, so they are stored without loss.
        """
        if pixels is None or min(pixels.shape[:2]) < 1:
            return _box("missing", alt)
        limit = min(self.encoding.longest_px, longest_px or self.encoding.longest_px)
        if not limit:
            return _box(_LEFT_OUT, alt)
        height, width = pixels.shape[:2]
        is_exact = is_measured and self.encoding is ENCODINGS[0]
        source = self.source(_shrink(pixels, limit), None if is_exact else self.encoding.quality)
        return void("img", src=source, alt=alt, width=width, height=height, **attributes)

    def magnify(self, pixels: np.ndarray | None, alt: str) -> str:
        """A small picture, each of its pixels a whole number of pixels on the page."""
        if pixels is None or min(pixels.shape[:2]) < 1:
            return _box("missing", alt)
        if not self.encoding.longest_px:
            return _box(_LEFT_OUT, alt)
        times = max(1, _CROP_ON_PAGE_PX // max(pixels.shape[:2]))
        height, width = (times * n for n in pixels.shape[:2])
        size = {"width": width, "height": height, "style": f"width:{width}px"}
        return void("img", src=self.source(pixels), alt=alt, class_="pixels", **size)

    def source(self, pixels: np.ndarray, quality: int | None = None, form: str = "WEBP") -> str:
        """An image as the source of an img element.

        * `pixels`: (rows, columns, 3) uint8, sRGB.
        * `quality`: None, without loss.
        * `form`, {"WEBP", "JPEG"}: with loss, JPEG keeps single pixels' colours.
        """
        options: dict[str, Any] = _LOSSLESS if quality is None else {"quality": quality}
        if form == "JPEG":
            # No "optimize": with it Pillow's JPEG writer runs out of buffer on noisy images.
            options["subsampling"] = 0
        elif max(pixels.shape) > _LONGEST_WEBP_PX:
            form, options = "PNG", {}
        coded = base64.b64encode(encode_image(pixels, form, self.cache, **options)).decode("ascii")
        return f"data:image/{form.lower()};base64,{coded}"

    def similarity(self, a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
        """SSIM map of two images in colours, (rows, columns, 3) uint8: black is 1.

        None unless both have the same size, and at least that of SSIM's window.
        """
        if a is None or b is None or a.shape != b.shape or min(a.shape[:2]) < SSIM_WINDOW:
            return None

        def make() -> np.ndarray:
            first, second = (linear_from_srgb(codes.astype(np.float32) / 255) for codes in (a, b))
            return magma(1 - ssim_map(first, second))

        code = code_digest("scores/metrics", "image", "report/images.py")
        return self.cached("map of SSIM", make, first=a, second=b, code=code)

    def similarity_scale(self) -> np.ndarray:
        """The colours of `similarity` from 1, at the left, to 0: (1, 256, 3) uint8."""

        # Read from the cache, it needs no plotter loaded.
        def make() -> np.ndarray:
            return magma(np.linspace(0, 1, 256)[None])

        return self.cached("scale of SSIM", make, code=code_digest("image", "report/images.py"))

    def drawing(self, product: str, make: Callable[[], bytes], **parts: Any) -> bytes:
        """A drawing from the cache, or drawn by `make`; loading matplotlib is slow."""
        code = code_digest("report", "display")
        return self.cached(
            product, lambda: np.frombuffer(make(), np.uint8), **parts, code=code
        ).tobytes()

    def cached(self, product: str, make: Callable[[], np.ndarray], **parts: Any) -> np.ndarray:
        """An array from the cache, or computed by `make` from the parts."""
        array: np.ndarray = self.cache.find_or_make(product, lambda: parts, make, explain=False)[0]
        return array


def difference(a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
    """|a − b| of the sRGB values, amplified and clipped; None for different sizes."""
    if a is None or b is None or a.shape != b.shape:
        return None
    change = np.abs(a.astype(np.int16) - b.astype(np.int16))
    return np.asarray(np.minimum(change * DIFFERENCE_GAIN, 255), np.uint8)


def is_wide(pixels: np.ndarray | None) -> bool:
    """True if an image is too wide for a narrow column."""
    return pixels is not None and pixels.shape[1] > _WIDE * pixels.shape[0]


def _box(reason: str, alt: str) -> str:
    words = element("b", text(reason)) + element("span", text(alt))
    return element("div", words, class_="missing")


def _shrink(pixels: np.ndarray, longest_px: int) -> np.ndarray:
    from PIL import Image

    height, width = pixels.shape[:2]
    scale = longest_px / max(height, width)
    if scale >= 1:
        return pixels
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))
