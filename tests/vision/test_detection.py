"""Bearings of rendered cones: below a third of a pixel in clear views, with sigmas that hold."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from mht_slam.arrays import FloatArray
from mht_slam.errors import ImageError, OptionError
from mht_slam.measurements import wrap_angle
from mht_slam.simulation.panorama import GREY, Body, View, cones_at, render_panorama, render_ring
from mht_slam.vision import DetectionOptions, PanoramaCamera, Ring, detect_cones

VIEW = View()
PIXEL = 2.0 * math.pi / VIEW.width


def place(bearing: float, distance: float) -> list[float]:
    return [distance * math.cos(bearing), distance * math.sin(bearing)]


def eight_bits(picture: FloatArray) -> np.ndarray:
    return np.round(255.0 * picture).astype(np.uint8)


def clear_view(
    seed: int, near: float, far: float
) -> tuple[FloatArray, list[Body], np.random.Generator]:
    """Bearings of eight cones that do not touch, and the cones."""
    rng = np.random.default_rng(seed)
    bearings = (np.arange(8) + rng.uniform(0.15, 0.85, 8)) * math.pi / 4.0
    distances = rng.uniform(near, far, 8)
    cones = cones_at([place(b, d) for b, d in zip(bearings, distances, strict=True)])
    return np.asarray(wrap_angle(bearings)), cones, rng


def errors(found: FloatArray, true: FloatArray) -> FloatArray:
    """Error of the detection nearest to each true bearing, which must be the only one."""
    apart = np.asarray(wrap_angle(found[None, :] - true[:, None]))
    nearest = np.abs(apart).argmin(axis=1)
    assert sorted(nearest.tolist()) == list(range(len(found))), "one detection for each cone"
    return apart[np.arange(len(true)), nearest][np.argsort(nearest)]


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(
    ("view", "near", "far"),
    [
        (VIEW, 2.5, 12.0),
        (VIEW, 12.0, 20.0),
        (replace(VIEW, noise=0.05), 2.5, 12.0),
        (replace(VIEW, blur=1.2), 2.5, 12.0),
        (replace(VIEW, grass=0.3, shading=0.3), 2.5, 12.0),
        (replace(VIEW, width=720, height=90), 2.5, 8.0),
    ],
    ids=["near", "far", "noisy", "blurred", "coarse grass and hard light", "few pixels"],
)
def test_clear_views_give_bearings_below_a_third_of_a_pixel(
    view: View, near: float, far: float
) -> None:
    everything, normalised = [], []
    for seed in range(8):
        true, cones, rng = clear_view(seed, near, far)
        found = detect_cones(eight_bits(render_panorama([0, 0, 0], cones, rng, view=view)))
        assert not found.lopsided.any()
        assert not found.touching.any()
        error = errors(found.bearings, true)
        everything.append(error * view.width / (2.0 * math.pi))
        normalised.append(error / found.sigmas)
    assert rms(np.concatenate(everything)) < 1.0 / 3.0
    # The sigma's floor is for light from the side; without it the errors are smaller still.
    assert 0.5 < rms(np.concatenate(normalised)) < 1.7


def test_sigmas_are_calibrated_over_views_as_they_come() -> None:
    normalised = []
    for seed in range(100, 118):
        true, cones, rng = clear_view(seed, 2.5, 20.0)
        found = detect_cones(eight_bits(render_panorama([0, 0, 0], cones, rng)))
        normalised.append(errors(found.bearings, true) / found.sigmas)
    assert 0.75 < rms(np.concatenate(normalised)) < 1.25


def test_a_cone_across_the_seam_is_one_cone_and_as_good_as_any() -> None:
    found_errors = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        bearing = rng.uniform(-2.0, 2.0) * PIXEL
        found = detect_cones(
            render_panorama([0, 0, 0], cones_at([place(bearing, rng.uniform(3, 10))]), rng)
        )
        assert found.mask[:, 0].any()
        assert found.mask[:, -1].any()
        found_errors.append(errors(found.bearings, np.array([bearing])) / PIXEL)
    assert rms(np.concatenate(found_errors)) < 1.0 / 3.0


@pytest.mark.parametrize("hidden", [0.25, 0.35, 0.5])
def test_a_partly_hidden_cone_is_lopsided_and_its_sigma_says_so(hidden: float) -> None:
    normalised = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        bearing, distance = rng.uniform(-3.0, 3.0), rng.uniform(4.0, 10.0)
        half = math.asin(0.18 / distance)
        post_half = math.asin(0.1 / (0.6 * distance))
        post = place(bearing - half + 2.0 * hidden * half - post_half, 0.6 * distance)
        bodies = [*cones_at([place(bearing, distance)]), Body(*post, 2.0, 0.1, 0.1, GREY)]
        found = detect_cones(render_panorama([0, 0, 0], bodies, rng))
        assert found.lopsided.tolist() == [True]
        assert found.sigmas[0] > PIXEL / 3.0
        normalised.append(errors(found.bearings, np.array([bearing])) / found.sigmas)
    assert rms(np.concatenate(normalised)) < 1.5


def test_cones_that_touch_are_cut_and_their_sigmas_are_wider() -> None:
    normalised = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        bearing, near = rng.uniform(-3.0, 3.0), rng.uniform(4.0, 7.0)
        far = near + 0.3
        together = math.asin(0.18 / near) + math.asin(0.18 / far)
        true = np.array([bearing, bearing + rng.uniform(0.7, 0.9) * together])
        cones = cones_at([place(true[0], near), place(true[1], far)])
        found = detect_cones(render_panorama([0, 0, 0], cones, rng))
        assert found.touching.tolist() == [True, True]
        assert (found.sigmas > 0.04 * found.widths).all()
        normalised.append(errors(found.bearings, np.asarray(wrap_angle(true))) / found.sigmas)
    assert rms(np.concatenate(normalised)) < 1.2


def test_a_far_cone_behind_the_flank_of_a_near_one_makes_one_lopsided_blob() -> None:
    near, far = 5.0, 9.0
    together = math.asin(0.18 / near) + math.asin(0.18 / far)
    cones = cones_at([place(1.0, near), place(1.0 + 0.6 * together, far)])
    found = detect_cones(render_panorama([0, 0, 0], cones, np.random.default_rng(0)))
    assert len(found) == 1
    assert found.lopsided[0]
    assert abs(found.bearings[0] - 1.0) < 3.0 * found.sigmas[0]


def test_a_cone_wholly_hidden_is_not_seen() -> None:
    bodies = [*cones_at([[8.0, 0.0], [0.0, 5.0]]), Body(4.0, 0.0, 2.0, 0.3, 0.3, GREY)]
    found = detect_cones(render_panorama([0, 0, 0], bodies, np.random.default_rng(0)))
    assert np.degrees(found.bearings) == pytest.approx([90.0], abs=0.1)


@pytest.fixture(scope="module")
def picture() -> FloatArray:
    _, cones, rng = clear_view(7, 3.0, 10.0)
    return render_panorama([0, 0, 0], cones, rng)


@settings(max_examples=8, deadline=None)
@given(shift=st.integers(0, VIEW.width - 1))
def test_turning_the_camera_by_columns_turns_the_bearings(picture: FloatArray, shift: int) -> None:
    still, turned = detect_cones(picture), detect_cones(np.roll(picture, shift, axis=1))
    expected = np.asarray(wrap_angle(still.bearings - shift * PIXEL))
    order = np.argsort(np.mod(still.columns + shift, VIEW.width))
    assert np.abs(wrap_angle(turned.bearings - expected[order])).max() < 1e-9
    assert turned.sigmas == pytest.approx(still.sigmas[order])


def test_a_mirror_image_is_read_the_other_way_round(picture: FloatArray) -> None:
    still = detect_cones(picture)
    # Column 0 of the mirror image is the last one of the picture.
    mirrored = PanoramaCamera(mounting_angle=PIXEL, direction="counter-clockwise")
    found = detect_cones(picture[:, ::-1], mirrored)
    assert found.bearings == pytest.approx(still.bearings[::-1], abs=1e-9)
    assert found.sigmas == pytest.approx(still.sigmas[::-1])


def test_a_ring_gives_the_bearings_of_its_panorama() -> None:
    true, cones, rng = clear_view(3, 2.5, 7.0)
    ring = Ring(262.3, 268.6, 90.0, 260.0)
    camera = PanoramaCamera(mounting_angle=0.7, direction="counter-clockwise", ring=ring)
    found = detect_cones(eight_bits(render_ring([0, 0, 0], cones, rng, camera=camera)), camera)
    panoramic = replace(camera, ring=None)
    same = detect_cones(render_panorama([0, 0, 0], cones, rng, camera=panoramic), panoramic)
    error = errors(found.bearings, true)
    # The horizon, where cones stand, is at about 200 pixels from the centre.
    assert rms(error) * 200.0 < 1.0 / 3.0
    assert rms(error / found.sigmas) < 1.5
    assert rms(errors(found.bearings, same.bearings)) * 200.0 < 1.0 / 3.0


def test_the_scan_holds_bearings_and_sigmas(picture: FloatArray) -> None:
    found = detect_cones(picture, options=DetectionOptions(extra_sigma=math.radians(0.3)))
    assert np.array_equal(found.scan.bearings, found.bearings)
    assert np.array_equal(found.scan.sigma, found.sigmas)
    plain = detect_cones(picture)
    assert found.sigmas == pytest.approx(np.hypot(plain.sigmas, math.radians(0.3)))
    assert np.array_equal(np.sort(plain.columns), plain.columns)
    assert plain.areas.sum() == plain.mask.sum()


def test_no_cone_is_an_error_unless_it_may_be() -> None:
    empty = render_panorama([0, 0, 0], [], np.random.default_rng(0))
    with pytest.raises(ImageError, match="no pixel matches"):
        detect_cones(empty)
    found = detect_cones(empty, options=DetectionOptions(allow_none=True))
    assert (len(found), len(found.scan)) == (0, 0)
    speckled = empty.copy()
    speckled[100, 50:53] = (0.95, 0.4, 0.08)
    with pytest.raises(ImageError, match="3 pixels match, but no blob"):
        detect_cones(speckled)


def test_a_picture_that_matches_everywhere_is_an_error() -> None:
    with pytest.raises(ImageError, match="100% of the pixels match"):
        detect_cones(np.full((40, 200, 3), (0.95, 0.4, 0.08)))


def test_what_is_flat_ragged_or_too_wide_is_no_cone() -> None:
    picture = np.full((60, 720, 3), 0.5)
    picture[30:32, 100:140] = (0.95, 0.4, 0.08)  # flat
    picture[10:50, 300:460] = (0.95, 0.4, 0.08)  # 80 degrees wide
    for step in range(40):  # a diagonal fills little of its box
        picture[10 + step, 550 + step] = (0.95, 0.4, 0.08)
    picture[20:40, 650:660] = (0.95, 0.4, 0.08)  # a post
    options = DetectionOptions(min_aspect=0.4)
    assert detect_cones(picture, options=options).columns == pytest.approx([654.5])


@pytest.mark.parametrize(("low", "high"), [(200.0, 260.0), (340.0, 20.0)])
def test_the_hue_window_may_go_through_red(low: float, high: float) -> None:
    colours = {230.0: (0.1, 0.25, 0.9), 350.0: (0.9, 0.1, 0.23), 10.0: (0.9, 0.23, 0.1)}
    picture = np.full((40, 360, 3), 0.5)
    for index, colour in enumerate(colours.values()):
        start = 50 + 100 * index
        picture[10:30, start : start + 9] = colour
    found = detect_cones(picture, options=DetectionOptions(hue_from_deg=low, hue_to_deg=high))
    assert found.columns.tolist() == pytest.approx([54.0] if low < high else [154.0, 254.0])


@pytest.mark.parametrize("width", [2, 8])
def test_a_background_of_more_chroma_leaves_the_threshold_to_tell(width: int) -> None:
    picture = np.full((40, 200, 3), (1.0, 0.0, 0.32))
    picture[10:30, 90 : 90 + width] = (0.6, 0.28, 0.28)
    found = detect_cones(picture)
    assert found.columns == pytest.approx([89.5 + width / 2])
    assert found.sigmas[0] > 0.05 * 2.0 * math.pi / 200.0


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 2.0))
def test_pictures_of_mere_noise_have_finite_bearings(seed: int, grain: float) -> None:
    speckle = np.random.default_rng(seed).random((40, 160, 3))
    picture = np.clip(gaussian_filter(speckle, (grain, grain, 0.0)), 0.0, 1.0)
    chosen = DetectionOptions(allow_none=True, min_area=1, min_saturation=0.3)
    found = detect_cones(picture, options=chosen)
    assert np.isfinite(found.bearings).all()
    assert (found.sigmas > 0.0).all()


def test_what_is_no_camera_and_no_options_is_refused(picture: FloatArray) -> None:
    with pytest.raises(OptionError, match="camera is int"):
        detect_cones(picture, 3)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="options is dict"):
        detect_cones(picture, options={})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "options",
    [
        {"hue_from_deg": -1.0},
        {"hue_to_deg": 361.0},
        {"min_saturation": 1.5},
        {"min_area": 0},
        {"max_width": 4.0},
        {"max_share": 0.0},
        {"extra_sigma": -1.0},
        {"allow_none": 1},
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict) -> None:
    with pytest.raises(OptionError, match=next(iter(options))):
        DetectionOptions(**options)
