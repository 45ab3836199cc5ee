"""`mht-slam bearings IMAGE... -o scans.jsonl`: the bearings of cones in panoramas."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console

from mht_slam.errors import ImageError, OptionError

if TYPE_CHECKING:
    from mht_slam.vision import DetectionOptions, PanoramaCamera, PanoramaDetections

SUFFIXES = (".jsonl", ".json")


@dataclass(frozen=True)
class Bearings:
    """Find cones in panoramas, or in the rings of catadioptric cameras, by their colour.

    One picture is one scan, in the order given. Beside the scan file stands a folder with a picture
    of what was detected in each. One wrong picture, and nothing is written.
    """

    images: tyro.conf.Positional[tuple[Path, ...]]
    """Pictures that show a whole turn."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Scan file to write: .jsonl or .json, which hold a sigma for each bearing."""
    overlays: bool = True
    """Write the pictures of what was detected, into OUTPUT without its suffix + _overlays."""
    mounting_deg: float = 0.0
    """Bearing of column 0 in the robot frame, degrees, counter-clockwise from forward; 180 where
    forward is in the middle."""
    direction: Literal["clockwise", "counter-clockwise"] = "clockwise"
    """How bearings run from left to right, seen from above."""
    ring: tuple[float, float, float, float] | None = None
    """For catadioptric pictures: column and row of the ring's centre, its inner and outer radius,
    pixels. Column 0 is then to the right of the centre, and columns go by the bottom."""
    hue_deg: tuple[float, float] = (345.0, 45.0)
    """Hues of the cones, from and to, degrees on the colour circle; through red where the first is
    the larger one."""
    min_saturation: float = 0.5
    """Least saturation of the cones, 0 to 1."""
    min_value: float = 0.3
    """Least value (brightness) of the cones, 0 to 1."""
    min_area: int = 12
    """Fewest pixels of a cone."""
    extra_sigma_deg: float = 0.0
    """Standard deviation that calibration, tilt and the like add to every bearing, degrees."""
    allow_none: bool = False
    """Take a picture without a cone as a scan in which nothing was seen."""

    def run(self, console: Console) -> None:
        """Detect in every picture, then write the scans and say where they are."""
        from mht_slam.datasets import write_scans

        camera, options = self._camera(), self._options()
        self._refuse_contradictions()
        scans = []
        with self._overlay_folder() as folder:
            for index, path in enumerate(self.images):
                detections = _detect(path, camera, options)
                scans.append(detections.scan)
                console.print(_line(path, detections), soft_wrap=True)
                if folder is not None:
                    from mht_slam.plotting.detections import detections_figure

                    figure = detections_figure(detections, path.name)
                    figure.savefig(folder / f"{index:03d}_{path.stem}.png", dpi=110)
            write_scans(self.output, scans)
        console.print(f"{len(scans)} scans: {self.output}", soft_wrap=True)

    def _camera(self) -> PanoramaCamera:
        from mht_slam.vision import PanoramaCamera, Ring

        ring = None
        if self.ring is not None:
            column, row, inner, outer = self.ring
            ring = Ring(row, column, inner, outer)
        return PanoramaCamera(
            mounting_angle=math.radians(self.mounting_deg), direction=self.direction, ring=ring
        )

    def _options(self) -> DetectionOptions:
        from mht_slam.vision import DetectionOptions

        return DetectionOptions(
            hue_from_deg=self.hue_deg[0],
            hue_to_deg=self.hue_deg[1],
            min_saturation=self.min_saturation,
            min_value=self.min_value,
            min_area=self.min_area,
            extra_sigma=math.radians(self.extra_sigma_deg),
            allow_none=self.allow_none,
        )

    @property
    def _overlay_path(self) -> Path:
        return self.output.with_name(f"{self.output.stem}_overlays")

    def _refuse_contradictions(self) -> None:
        if not self.images:
            raise OptionError("images: none: name at least one picture")
        if self.output.suffix.lower() not in SUFFIXES:
            raise OptionError(
                f"output: {self.output}: sigmas have no place there: name a .jsonl file"
            )
        if not self.output.parent.is_dir():
            raise OptionError(f"output: {self.output.parent} is no folder: make it")
        for path in (self.output, *([self._overlay_path] if self.overlays else [])):
            if path.exists():
                raise OptionError(f"output: {path} exists: name a file that does not")

    @contextmanager
    def _overlay_folder(self) -> Iterator[Path | None]:
        """A folder that gets its name when all is done, and else leaves nothing behind."""
        if not self.overlays:
            yield None
            return
        path = self._overlay_path
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as temporary:
            folder = Path(temporary) / path.name
            folder.mkdir()
            yield folder
            shutil.move(folder, path)


def _detect(path: Path, camera: PanoramaCamera, options: DetectionOptions) -> PanoramaDetections:
    from mht_slam.vision import detect_cones, read_image

    image = read_image(path)
    try:
        return detect_cones(image, camera, options)
    except ImageError as error:
        raise ImageError(f"{path}: {str(error).removeprefix('image: ')}") from error


def _line(path: Path, detections: PanoramaDetections) -> str:
    bearings = ", ".join(f"{math.degrees(angle):.2f}" for angle in detections.bearings.tolist())
    return f"{path}: {len(detections)} cones" + (f" at {bearings} deg" if bearings else "")
