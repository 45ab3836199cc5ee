"""Every exception the library raises on purpose, in one tree.

Each is a subclass of `MhtSlamError` and of the built-in that fits, so both
``except MhtSlamError`` and ``except ValueError`` do what a reader expects.
"""


class MhtSlamError(Exception):
    """Base of every error that mht-slam raises on purpose."""


class MeasurementError(MhtSlamError, ValueError):
    """A scan, odometry step or run that cannot be a measurement."""


class AssociationError(MhtSlamError, ValueError):
    """A table that is not a partition of the detections."""


class OptionError(MhtSlamError, ValueError):
    """An option of a call, or a field of a model, that makes no sense."""


class TooFewLandmarksError(MhtSlamError, ValueError):
    """Fewer than three landmarks: a frame attached to two leaves nothing to compare."""


class UnequalScansError(MhtSlamError, ValueError):
    """Scans of different length where every landmark must be seen in every scan."""


class NoEstimateError(MhtSlamError, ValueError):
    """A hypothesis that the factor graph could not solve, asked for its estimate."""


class UnobservableError(MhtSlamError, ValueError):
    """Associations that no bearing can contradict: only priors would rank them."""


class ScanFileError(MhtSlamError, ValueError):
    """A scan file that is malformed; the message names file, line and field."""


class CheckpointError(MhtSlamError, ValueError):
    """A file that is no checkpoint of the incremental estimator, or a damaged one."""


class RecordingError(MhtSlamError, ValueError):
    """A public recording that does not have the format its reader expects."""


class RecordingNotFoundError(MhtSlamError, FileNotFoundError):
    """A recording that is not where it was looked for."""


class ImageError(MhtSlamError, ValueError):
    """A picture that is none, has another shape than needed, or shows no landmark."""


class ImageNotFoundError(MhtSlamError, FileNotFoundError):
    """A picture that is not where it was looked for."""


class MissingExtraError(MhtSlamError, ImportError):
    """A part of the package whose optional dependencies are not installed."""
