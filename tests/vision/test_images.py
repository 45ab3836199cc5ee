"""What is no picture is refused in one clear line; what is one reads the same in every type."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from mht_slam.errors import ImageError, ImageNotFoundError, MhtSlamError, MissingExtraError
from mht_slam.vision import detect_cones, read_image
from mht_slam.vision.images import colour_image, scikit_image, write_image

PICTURE = np.random.default_rng(0).integers(0, 256, (20, 40, 3), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp"])
def test_a_picture_reads_as_it_was_written(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"picture{suffix}"
    write_image(path, PICTURE / 255.0)
    assert np.array_equal(read_image(path), PICTURE / 255.0)


def test_every_type_of_pixel_is_scaled_to_one() -> None:
    expected = PICTURE / 255.0
    assert np.array_equal(colour_image(PICTURE), expected)
    assert colour_image(PICTURE.astype(np.uint16) * 257) == pytest.approx(expected)
    assert np.array_equal(colour_image(expected), expected)


def test_what_is_transparent_is_white() -> None:
    opacity = np.zeros((20, 40, 1), dtype=np.uint8)
    assert (colour_image(np.concatenate([PICTURE, opacity], axis=2)) == 1.0).all()


def test_the_callers_array_is_left_alone() -> None:
    picture = np.full((20, 60, 3), 0.5)
    picture[5:15, 28:32] = (0.95, 0.4, 0.08)
    before = picture.copy()
    detect_cones(picture)
    assert np.array_equal(picture, before)
    picture[0, 0] = 0.0  # still writable


@pytest.mark.parametrize(
    ("pixels", "words"),
    [
        (np.zeros((20, 40)), "grey"),
        (np.zeros((20, 40, 1)), "grey"),
        (np.zeros((5, 20, 40, 3)), "one picture"),
        (np.zeros((20, 40, 7)), "rows x columns x 3"),
        (np.zeros((2, 40, 3)), "at least 8"),
        (np.full((20, 40, 3), 7.0), "outside"),
        (np.full((20, 40, 3), np.nan), "outside"),
        (np.zeros((20, 40, 3), dtype=np.int64), "type int64"),
        (np.zeros((20, 40, 3), dtype=np.complex128), "type complex128"),
        ("picture.png", "shape"),
        ([], "shape"),
        ([[1], [1, 2]], "no array"),
    ],
)
def test_an_array_that_is_no_colour_picture_is_refused(pixels: object, words: str) -> None:
    with pytest.raises(ImageError, match=words) as caught:
        detect_cones(pixels)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_none_or_no_picture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ImageNotFoundError, match=r"nowhere\.png: no such file"):
        read_image(tmp_path / "nowhere.png")
    with pytest.raises(ImageNotFoundError):
        read_image(tmp_path)
    for name, content in (("text.png", b"not a picture"), ("empty.jpg", b""), ("a.tif", b"II*\0")):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(ImageError, match="cannot be read as a picture") as caught:
            read_image(path)
        assert "\n" not in str(caught.value)


def test_a_picture_that_ends_too_early_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    write_image(path, PICTURE / 255.0)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ImageError, match="cannot be read"):
        read_image(path)


def test_a_missing_extra_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "skimage", None)
    monkeypatch.delitem(sys.modules, "skimage.color", raising=False)
    with pytest.raises(MissingExtraError, match=r"pip install 'mht-slam\[vision\]'") as caught:
        scikit_image("color")
    assert isinstance(caught.value, (MhtSlamError, ImportError))
