# SPDX-License-Identifier: BSD-3-Clause
"""Pictures for the models: drawing, an atlas of pictures and colours, noise, and writing PNG."""

import struct
import zlib

import numpy as np

_TILE_PX = 4  # a plain colour's square in an atlas
# Letters five wide, seven high: a number per column, its lowest bit on top.
_FONT_COLUMNS = bytes.fromhex(
    "7C1211127C7F494949363E414141227F4141413E7F494949417F090909013E414151737F0808087F00417F41002040413F01"
    "7F081422417F404040407F021C027F7F0408107F3E4141413E7F090909063E4151215E7F09192946264949493201017F0101"
    "3F4040403F1F2040201F3F4038403F631408146303047804036159494D433E5149453E00427F40007249494946"
    "2141494D331814127F1027454545393C4A49493141211109073649494936464949291E"
)
_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"
_FONT = {letter: _FONT_COLUMNS[5 * k : 5 * k + 5] for k, letter in enumerate(_LETTERS)}
_FONT[" "] = bytes(3)


class Picture:
    """A picture to draw on. Places are fractions: x from the left, y from the bottom, both 0..1."""

    def __init__(self, width_px, height_px, color):
        """Fill a new picture with a colour (3,) in 0..255."""
        self.image = np.zeros((height_px, width_px, 3)) + np.asarray(color, dtype=float)
        self._x, self._y = np.meshgrid(
            (np.arange(width_px) + 0.5) / width_px, 1.0 - (np.arange(height_px) + 0.5) / height_px
        )

    def rect(self, low, high, color):
        """Fill the rectangle between two corners (x, y)."""
        self.image[(self._x >= low[0]) & (self._x < high[0]) & (self._y >= low[1]) & (self._y < high[1])] = color
        return self

    def polygon(self, corners, color):
        """Fill a simple polygon (n, 2)."""
        inside = np.zeros(self._x.shape, dtype=bool)
        for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]]):
            if y0 != y1:
                crosses = (y0 > self._y) != (y1 > self._y)
                inside ^= crosses & (self._x < x0 + (self._y - y0) / (y1 - y0) * (x1 - x0))
        self.image[inside] = color
        return self

    def disc(self, centre, radius, color):
        """Fill a disc; the radius is a fraction of the picture's width."""
        self.image[self._distance(centre, centre) <= radius] = color
        return self

    def line(self, start, end, width, color):
        """Draw a line with round ends; the width is a fraction of the picture's width."""
        self.image[self._distance(start, end) <= width / 2] = color
        return self

    def text(self, words, low, high, color):
        """Write capital letters and digits into the rectangle between two corners."""
        columns = [column for letter in words for column in (*_FONT[letter], 0)][:-1]
        bits = np.array([[column >> row & 1 for column in columns] for row in range(7)], dtype=bool)
        row = np.floor((high[1] - self._y) / (high[1] - low[1]) * 7).astype(int)
        column = np.floor((self._x - low[0]) / (high[0] - low[0]) * len(columns)).astype(int)
        within = (row >= 0) & (row < 7) & (column >= 0) & (column < len(columns))
        self.image[within & bits[np.clip(row, 0, 6), np.clip(column, 0, len(columns) - 1)]] = color
        return self

    def paste(self, image, low, high):
        """Put an (h, w, 3) image into the rectangle between two corners."""
        height_px, width_px = self.image.shape[:2]
        x = np.arange(round(low[0] * width_px), round(high[0] * width_px))
        y = np.arange(round((1 - high[1]) * height_px), round((1 - low[1]) * height_px))
        rows = np.arange(len(y)) * image.shape[0] // max(len(y), 1)
        columns = np.arange(len(x)) * image.shape[1] // max(len(x), 1)
        self.image[y[0] : y[-1] + 1, x[0] : x[-1] + 1] = image[np.ix_(rows, columns)]
        return self

    def _distance(self, start, end):
        """Distance of every pixel from a line, in widths of the picture."""
        ratio = self.image.shape[0] / self.image.shape[1]
        a, b = (np.array([p[0], p[1] * ratio]) for p in (start, end))
        along = b - a
        x, y = self._x - a[0], self._y * ratio - a[1]
        t = np.clip((x * along[0] + y * along[1]) / max(along @ along, 1e-12), 0.0, 1.0)
        return np.hypot(x - t * along[0], y - t * along[1])


class Atlas:
    """One texture out of named colours and pictures.

    Atlas({"black": (38, 38, 40), "front": picture.image}): a colour becomes a small square, an (h, w, 3) image keeps
    its pixels. Images are laid out in rows, tall ones first; width_px must hold the widest.
    """

    def __init__(self, parts, width_px=128):
        """Lay out the parts."""
        boxes, x, y, row_px = {}, 0, 0, 0
        images = {name: self._to_image(part) for name, part in parts.items()}
        for name, image in sorted(images.items(), key=lambda item: -item[1].shape[0]):
            height, width = image.shape[:2]
            if x + width > width_px:
                x, y, row_px = 0, y + row_px, 0
            boxes[name] = (x, y, width, height)
            x, row_px = x + width, max(row_px, height)
        height_px = y + row_px
        self.image = np.zeros((height_px, width_px, 3))
        self._patches = {}
        for name, (left, top, width, height) in boxes.items():
            self.image[top : top + height, left : left + width] = images[name]
            edge = 0.5 if images[name].shape[0] != _TILE_PX else _TILE_PX / 2 - 0.5
            self._patches[name] = (
                (left + edge) / width_px,
                1.0 - (top + height - edge) / height_px,
                (left + width - edge) / width_px,
                1.0 - (top + edge) / height_px,
            )

    def patch(self, name, low=(0.0, 0.0), high=(1.0, 1.0)):
        """Patch (u0, v0, u1, v1) of a part, or of the piece of it between two corners (x, y) in 0..1, y upwards."""
        u0, v0, u1, v1 = self._patches[name]
        return (
            u0 + low[0] * (u1 - u0), v0 + low[1] * (v1 - v0),
            u0 + high[0] * (u1 - u0), v0 + high[1] * (v1 - v0),
        )  # fmt: skip

    def write(self, path):
        """Write the texture as PNG."""
        write_png(path, self.image)

    @staticmethod
    def _to_image(part):
        part = np.asarray(part, dtype=float)
        return np.zeros((_TILE_PX, _TILE_PX, 3)) + part if part.ndim == 1 else part


def write_model(folder, name, mesh, atlas):
    """Write NAME.obj, NAME.mtl and textures/NAME.png."""
    (folder / "textures").mkdir(parents=True, exist_ok=True)
    atlas.write(folder / "textures" / f"{name}.png")
    mesh.write(folder, name, f"textures/{name}.png")


def write_png(path, image):
    """Write an (h, w, 3) image with values in 0..255 as an 8-bit PNG."""
    image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    height, width = image.shape[:2]
    raw = b"".join(b"\0" + row.tobytes() for row in image)

    def chunk(tag, data):
        return struct.pack(">I", len(data)) + tag + data + struct.pack(">I", zlib.crc32(tag + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b"")
    )


def make_rng(seed):
    """Random numbers that are the same on every run; the seed is a number or a name."""
    seed = zlib.crc32(seed.encode()) if isinstance(seed, str) else seed
    return np.random.Generator(np.random.PCG64(seed))


def tileable_noise(rng, size_px, octaves):
    """Sum of smooth periodic noise (size_px, size_px), zero mean and unit deviation."""
    frequency = np.fft.fftfreq(size_px) * size_px
    radius = np.hypot(*np.meshgrid(frequency, frequency))
    spectrum = np.fft.fft2(rng.standard_normal((size_px, size_px))) / np.maximum(radius, 1.0)
    spectrum[radius > 2**octaves] = 0.0
    noise = np.real(np.fft.ifft2(spectrum))
    return (noise - noise.mean()) / noise.std()


def wood_grain(rng, shape_px, color, dark):
    """Boards (h, w, 3) with grain along the picture's x axis, between two colours."""
    grain = rng.standard_normal((shape_px[0], 1)) + 0.3 * rng.standard_normal(shape_px)
    mix = np.clip(0.35 + 0.22 * grain, 0, 1)[..., None]
    return (1 - mix) * np.asarray(color) + mix * np.asarray(dark)
