# SPDX-License-Identifier: BSD-3-Clause
"""Images of compressed topics come out as the camera had them."""

import struct

import cv2
import numpy as np
import pytest

from core_perception.compressed_image import decode_image
from core_perception.exceptions import EvidenceError

RGB = np.zeros((40, 60, 3), np.uint8)
RGB[:, :30], RGB[:, 30:] = (200, 40, 10), (10, 90, 220)
MM = np.arange(40 * 60, dtype=np.uint16).reshape(40, 60)


def file_of(pixels, kind="png"):
    return cv2.imencode("." + kind, pixels)[1].tobytes()


def as_rgb(pixels, encoding):
    return {"rgb8": pixels, "bgr8": pixels[:, :, ::-1]}[encoding]


# What image_transport writes today, what it wrote before it named the colours, and what web cameras write.
@pytest.mark.parametrize(
    ("kind", "written"),
    [
        ("rgb8; jpeg compressed bgr8", RGB[:, :, ::-1]),
        ("bgr8; png compressed bgr8", RGB[:, :, ::-1]),
        ("jpeg", RGB[:, :, ::-1]),
        ("png", RGB[:, :, ::-1]),
        ("rgb8; png compressed ", RGB),
    ],
)
def test_colours_are_those_of_the_camera(kind, written):
    pixels, encoding = decode_image(file_of(written, "jpeg" if "jpeg" in kind else "png"), kind)
    assert (pixels.dtype, pixels.shape) == (np.uint8, RGB.shape)
    assert np.abs(as_rgb(pixels, encoding)[:, 4:26].astype(int) - RGB[:, 4:26]).max() < 8


def test_transparency_is_left_out_and_grey_stays_grey():
    bgra = np.dstack([RGB[:, :, ::-1], np.full(RGB.shape[:2], 7, np.uint8)])
    pixels, encoding = decode_image(file_of(bgra), "png")
    assert (as_rgb(pixels, encoding) == RGB).all()
    pixels, encoding = decode_image(file_of(RGB[:, :, 0]), "mono8; png compressed ")
    assert encoding == "mono8" and (pixels == RGB[:, :, 0]).all()


@pytest.mark.parametrize("kind", ["16UC1; compressedDepth", "16UC1; compressedDepth png", "mono16; compressedDepth"])
def test_millimetres_come_back_bit_for_bit(kind):
    pixels, encoding = decode_image(struct.pack("<i2f", 0, 0.0, 0.0) + file_of(MM), kind)
    assert encoding == "16UC1" and pixels.dtype == np.uint16 and (pixels == MM).all()


def test_sixteen_bits_in_a_plain_png_come_back_bit_for_bit():
    pixels, encoding = decode_image(file_of(MM), "16UC1; png compressed ")
    assert encoding == "16UC1" and (pixels == MM).all()


def test_metres_are_those_of_the_inverse_that_was_written_and_0_is_nothing():
    # As compressed_depth_image_transport writes it: A = q (q + 1), B = 1 - A / max.
    quantisation, largest_m = 100.0, 10.0
    a = quantisation * (quantisation + 1.0)
    b = 1.0 - a / largest_m
    depth_m = np.linspace(0.5, 9.0, 40 * 60).reshape(40, 60)
    values = np.round(a / depth_m + b).astype(np.uint16)
    values[0, :5] = 0
    pixels, encoding = decode_image(struct.pack("<i2f", 0, a, b) + file_of(values), "32FC1; compressedDepth")
    assert encoding == "32FC1" and pixels.dtype == np.float32
    assert np.isnan(pixels[0, :5]).all()
    assert np.abs(pixels.ravel()[5:] - depth_m.ravel()[5:]).max() < 0.005


@pytest.mark.parametrize(
    ("data", "kind", "words"),
    [
        (b"", "jpeg", "got no image"),
        (b"\xff\xd8garbage", "rgb8; jpeg compressed bgr8", "got no image"),
        (file_of(RGB)[:50], "png", "got no image"),
        (file_of(np.dstack([MM, MM, MM])), "png", "got uint16"),
        (b"short", "16UC1; compressedDepth", "a header of 12"),
        (bytes(12) + file_of(RGB), "16UC1; compressedDepth", "got '16UC1' in uint8"),
        (bytes(12) + file_of(MM), "8UC1; compressedDepth", "got '8UC1'"),
        (bytes(12) + file_of(MM), "16UC1; compressedDepth rvl", "got RVL, allowed PNG"),
    ],
)
def test_what_is_no_such_image_is_refused_in_words(data, kind, words):
    with pytest.raises(EvidenceError, match=words):
        decode_image(data, kind)


def test_a_jpeg_that_is_cut_off_is_refused_and_one_with_filling_is_not():
    data = file_of(RGB[:, :, ::-1], "jpeg")
    assert decode_image(data + b"\0\0", "jpeg")[0].shape == RGB.shape
    for share in (0.5, 0.9):
        with pytest.raises(EvidenceError, match="cut off|no image"):
            decode_image(data[: int(share * len(data))], "jpeg")


def test_an_image_of_a_size_nobody_has_is_refused_in_words():
    data = bytearray(file_of(RGB))
    data[16:24] = struct.pack(">II", 70000, 70000)
    with pytest.raises(EvidenceError):
        decode_image(bytes(data), "png")
