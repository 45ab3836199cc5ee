"""How far an estimated trajectory is from its reference, once their frames are aligned."""

from __future__ import annotations

import cmath
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.errors import OptionError
from mht_slam.measurements import wrap_angle


class Alignment(NamedTuple):
    """A similarity of the plane: turn by `rotation` (radians), stretch by `scale`, then move."""

    scale: float
    rotation: float
    translation: tuple[float, float]

    def points(self, points: npt.ArrayLike) -> FloatArray:
        """Return (k, 2) points in the frame of the reference."""
        z = cmath.rect(self.scale, self.rotation) * _complex(np.asarray(points, dtype=np.float64))
        z = z + complex(*self.translation)
        return np.column_stack([z.real, z.imag])

    def poses(self, poses: npt.ArrayLike) -> FloatArray:
        """Return (m, 3) poses in the frame of the reference."""
        given = np.asarray(poses, dtype=np.float64)
        return np.column_stack([self.points(given), wrap_angle(given[:, 2] + self.rotation)])


class TrajectoryErrors(NamedTuple):
    """Errors of a trajectory after alignment.

    Attributes
    ----------
    position : root mean square distance of the poses (ATE), in the unit of the reference; NaN
        where the two have no pose in common.
    heading : root mean square heading error, radians; NaN without a heading in common.
    alignment : that was used; its scale is what the estimate's lengths have to be multiplied by.
    n_poses : poses that both know.
    """

    position: float
    heading: float
    alignment: Alignment
    n_poses: int


def align(estimated: npt.ArrayLike, reference: npt.ArrayLike, *, with_scale: bool) -> Alignment:
    """Return the alignment of least squared distances from (m, 3) poses to reference poses.

    Umeyama's in the plane, Sim(2) with the scale and SE(2) without: with centred positions as
    complex numbers, the factor that takes one into the other is sum(conj(e) r) / sum(|e|^2). It is
    never a reflection, and collinear positions are as good as others. Where the positions of one of
    the two do not differ, the headings turn the frame and its scale stays 1.

    Poses with a position that is NaN in one of the two are left out; headings may be NaN. Raises
    `OptionError` for other shapes.
    """
    ours, theirs = _poses(estimated, "estimated"), _poses(reference, "reference")
    if len(ours) != len(theirs):
        raise OptionError(f"{len(ours)} estimated and {len(theirs)} reference poses: give the same")
    known = _known(ours) & _known(theirs)
    if not known.any():
        return Alignment(1.0, 0.0, (0.0, 0.0))
    e, r = _complex(ours[known]), _complex(theirs[known])
    middle_e, middle_r = e.mean(), r.mean()
    e, r = e - middle_e, r - middle_r
    product, spread = complex(np.vdot(e, r)), float(np.vdot(e, e).real)
    if abs(product) > 0.0:
        rotation = cmath.phase(product)
        scale = abs(product) / spread if with_scale else 1.0
    else:
        turned = (theirs - ours)[known, 2]
        rotation = cmath.phase(np.exp(1j * turned[np.isfinite(turned)]).sum())
        scale = 1.0
    move = middle_r - cmath.rect(scale, rotation) * middle_e
    return Alignment(float(scale), rotation, (move.real, move.imag))


def trajectory_errors(
    estimated: npt.ArrayLike, reference: npt.ArrayLike, *, with_scale: bool
) -> TrajectoryErrors:
    """Align (m, 3) poses with their reference and measure what is left; see `align`.

    >>> reference = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 4.0, 0.1]])
    >>> errors = trajectory_errors([[5, 0, -1.5], [6, 0, -1.5], [7, 0, -1.5]], reference,
    ...                            with_scale=True)
    >>> round(errors.position, 9), errors.alignment.scale
    (0.0, 2.0)
    """
    alignment = align(estimated, reference, with_scale=with_scale)
    ours, theirs = alignment.poses(estimated), np.asarray(reference, dtype=np.float64)
    known = _known(ours) & _known(theirs)
    apart = np.hypot(*(ours - theirs)[known, :2].T)
    turned = wrap_angle((ours - theirs)[:, 2])
    turned = turned[np.isfinite(turned)]
    return TrajectoryErrors(_rms(apart), _rms(turned), alignment, int(known.sum()))


def _poses(value: npt.ArrayLike, name: str) -> FloatArray:
    poses = np.asarray(value, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3:
        raise OptionError(f"{name} has shape {poses.shape}: give (m, 3) poses x, y, theta")
    return poses


def _known(poses: FloatArray) -> BoolArray:
    return np.asarray(np.isfinite(poses[:, :2]).all(axis=1))


def _complex(points: FloatArray) -> npt.NDArray[np.complex128]:
    return points[:, 0] + 1j * points[:, 1]


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else float("nan")
