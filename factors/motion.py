"""How poses follow each other: on a line, straight ahead, smoothly, or as the odometer says.

GTSAM measures the difference of two ``Pose2`` with the logarithm of SE(2), which couples position
and heading: a prior pose with a loose x and a tight y does *not* hold a robot with a jittering
heading on the x axis. Hence the line is held by a translation prior and the heading by its own
factor. Motion between poses is measured from the expected motion, where the two agree to first
order.
"""

from __future__ import annotations

import math

import gtsam
import numpy as np
import numpy.typing as npt

from mht_slam.factors.density import FREE_SIGMA


def heading_prior(pose: int, heading: float, sigma: float) -> gtsam.PriorFactorPose2:
    """Heading of a pose (radians) with standard deviation `sigma`; its position stays free."""
    noise = gtsam.noiseModel.Diagonal.Sigmas([FREE_SIGMA, FREE_SIGMA, sigma])
    return gtsam.PriorFactorPose2(pose, gtsam.Pose2(0.0, 0.0, heading), noise)


def on_line(pose: int, offset: float, sigma: float) -> gtsam.PoseTranslationPrior2D:
    """Pose on the line y = `offset`, up to `sigma`; x and heading stay free."""
    noise = gtsam.noiseModel.Diagonal.Sigmas([FREE_SIGMA, sigma])
    return gtsam.PoseTranslationPrior2D(pose, np.array([0.0, offset]), noise)


def straight_segment(
    pose: int, next_pose: int, heading_sigma: float
) -> tuple[gtsam.BearingFactorPose2, gtsam.BearingFactorPose2]:
    """Both poses head along the segment from the first to the second, up to `heading_sigma`.

    The first sees the second straight ahead and is seen straight behind. The direction and the
    length of the segment stay free.
    """
    noise = gtsam.noiseModel.Isotropic.Sigma(1, heading_sigma)
    return (
        gtsam.BearingFactorPose2(pose, next_pose, gtsam.Rot2(0.0), noise),
        gtsam.BearingFactorPose2(next_pose, pose, gtsam.Rot2(math.pi), noise),
    )


def log_step(
    pose: int, next_pose: int, log_mean: float, log_sigma: float, around: float
) -> gtsam.RangeFactorPose2:
    """Log-normal step length, ln s ~ N(`log_mean`, `log_sigma`^2), linearised at s = `around`.

    GTSAM has no log-normal factor in C++. With s0 = `around`, the residual (ln s - mean) / sigma
    and its derivative at s0 are those of a Gaussian on s with mean s0 (1 - ln s0 + `log_mean`)
    and standard deviation s0 `log_sigma`. Solve, put the new step in, solve again: at the fixed
    point value, gradient and Gauss-Newton curvature are exact.
    """
    mean = around * (1.0 - math.log(around) + log_mean)
    noise = gtsam.noiseModel.Isotropic.Sigma(1, around * log_sigma)
    return gtsam.RangeFactorPose2(pose, next_pose, mean, noise)


def smooth_motion(
    pose: int,
    next_pose: int,
    step: float,
    step_sigma: float,
    lateral_sigma: float,
    heading_sigma: float,
) -> gtsam.BetweenFactorPose2:
    """Drive about `step` forward with a heading that walks.

    Forward motion has standard deviation `step_sigma`, lateral motion `lateral_sigma`, the change
    of heading `heading_sigma` (radians). A sigma of `FREE_SIGMA` leaves a direction free.

    Lateral means across the heading of `pose`: a robot that turns by w on an arc ends up about
    `step` w / 2 beside it, which `lateral_sigma` has to allow for.
    """
    noise = gtsam.noiseModel.Diagonal.Sigmas([step_sigma, lateral_sigma, heading_sigma])
    return gtsam.BetweenFactorPose2(pose, next_pose, gtsam.Pose2(step, 0.0, 0.0), noise)


def odometry(
    pose: int,
    next_pose: int,
    motion: tuple[float, float, float],
    covariance: npt.ArrayLike,
) -> gtsam.BetweenFactorPose2:
    """Motion (dx, dy, dtheta) in the frame of `pose`, with its (3, 3) covariance.

    GTSAM keeps the covariance in the tangent space at the motion. An odometer states it for the
    increments themselves, so it is carried over with the Jacobian of the SE(2) logarithm at the
    measured motion: rotation into the frame after the motion, which is exact to first order.
    """
    cosine, sine = math.cos(motion[2]), math.sin(motion[2])
    into_next = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    tangent = into_next @ np.asarray(covariance, dtype=np.float64) @ into_next.T
    noise = gtsam.noiseModel.Gaussian.Covariance(0.5 * (tangent + tangent.T))
    return gtsam.BetweenFactorPose2(pose, next_pose, gtsam.Pose2(*motion), noise)


def turn(pose: int, next_pose: int, sigma: float) -> gtsam.BetweenFactorPose2:
    """Change of heading from one pose to the next (radians), zero up to `sigma`."""
    noise = gtsam.noiseModel.Diagonal.Sigmas([FREE_SIGMA, FREE_SIGMA, sigma])
    return gtsam.BetweenFactorPose2(pose, next_pose, gtsam.Pose2(), noise)


def standstill(pose: int, next_pose: int, sigma: float) -> gtsam.BetweenFactorPose2:
    """The same pose twice, up to `sigma` in each of x, y and heading."""
    noise = gtsam.noiseModel.Isotropic.Sigma(3, sigma)
    return gtsam.BetweenFactorPose2(pose, next_pose, gtsam.Pose2(), noise)


def drift(pose: int, next_pose: int, sigma: float) -> gtsam.BearingFactorPose2:
    """Direction of the next pose from this one: straight ahead, up to `sigma` (radians)."""
    noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
    return gtsam.BearingFactorPose2(pose, next_pose, gtsam.Rot2(0.0), noise)


def step_change(
    keys: tuple[int, int, int], around: npt.NDArray[np.float64], sigma: float
) -> gtsam.LinearContainerFactor:
    """Two consecutive steps alike, ln(s2 / s1) ~ N(0, `sigma`^2), linearised at poses `around`.

    `around` holds the three poses, (3, 3) of x, y, theta. GTSAM has no such factor in C++, so its
    residual (ln s2 - ln s1) / sigma and Jacobian at `around` go into a linear one of unit noise.
    Solve, put the new poses in, solve again: at the fixed point value, gradient and Gauss-Newton
    curvature are exact. The normaliser of `sigma` is not in the factor.

    With u the unit vector of a step of length s from pose a to b, d ln s = u . (db - da) / s, and
    a pose moves by its own axes: da = R_a times the tangent's translation.
    """
    steps = np.diff(around[:, :2], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    first, second = steps / lengths[:, None] ** 2
    values = gtsam.Values()
    jacobians = []
    for key, (x, y, theta), gradient in zip(
        keys, around.tolist(), (first, -first - second, second), strict=True
    ):
        values.insert(key, gtsam.Pose2(x, y, theta))
        cosine, sine = math.cos(theta), math.sin(theta)
        forward = cosine * gradient[0] + sine * gradient[1]
        leftward = -sine * gradient[0] + cosine * gradient[1]
        jacobians.append(np.array([[forward, leftward, 0.0]]) / sigma)
    residual = math.log(lengths[1] / lengths[0]) / sigma
    unit = gtsam.noiseModel.Unit.Create(1)
    (a, b, c), (da, db, dc) = keys, jacobians
    linear = gtsam.JacobianFactor(a, da, b, db, c, dc, np.array([-residual]), unit)
    return gtsam.LinearContainerFactor(linear, values)
