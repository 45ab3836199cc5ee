"""`mht-slam simulate`: a scan file with its truth, from a kind of scene and a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

from rich.console import Console

from mht_slam.cli.model_options import EPSILON_OVER_SIGMA
from mht_slam.cli.run_folder import run_folder, to_json, write_json
from mht_slam.errors import OptionError

if TYPE_CHECKING:
    from mht_slam.simulation import Scene

Kind: TypeAlias = Literal["annulus", "one_sided", "corridor", "clusters", "model", "paper"]
Noise: TypeAlias = Literal["uniform", "gaussian", "heavy_tailed"]
ScanFormat: TypeAlias = Literal["jsonl", "csv"]

TRUTH_FILE = "world.json"
PANORAMAS = "panoramas"


@dataclass(frozen=True)
class Simulate:
    """Simulate a straight run past look-alike landmarks and write its scans with the truth.

    The stamped folder holds the scan file, the true poses and landmarks (world.json, in
    baselines) and the configuration.
    """

    kind: Kind = "annulus"
    """Layout of the landmarks; `model` draws them, the steps and the noise from the default
    observation model; `paper` is the paper's experiment."""
    landmarks: int = 4
    """Number of landmarks; the paper's experiment has its own."""
    n_scans: int = 3
    """Number of scans, at least 3; the paper's experiment has three."""
    noise: Noise = "uniform"
    """Uniform inside epsilon, Gaussian of sigma, or heavy-tailed of scale sigma."""
    epsilon_deg: float = 3.0
    """Vision error, degrees: the bound of uniform noise."""
    sigma_deg: float | None = None
    """Size of Gaussian or heavy-tailed noise, degrees. Default: epsilon / sqrt(3)."""
    seed: int = 0
    """Seed of everything random: the same seed gives the same bytes."""
    pair: bool = False
    """Two straight runs of two scans each instead of one run (for `solve --pair`)."""
    panoramas: bool = False
    """Also draw what a panoramic camera sees at each pose, of kind paper (for `bearings`)."""
    file_format: ScanFormat = "jsonl"
    """Format of the scan file."""
    output: Path = Path("runs")
    """Folder in which every run gets its own stamped folder; `latest` there leads to the last."""

    def run(self, console: Console) -> None:
        """Simulate, write the files and say where they are."""
        from mht_slam.datasets import write_scans

        scene = self._scene()
        configuration = {"seed": self.seed, "options": to_json(self)}
        with run_folder(self.output, "simulate", configuration) as folder:
            path = folder / f"scans.{self.file_format}"
            write_scans(path, scene.scans, scene.truth)
            write_json(
                folder / TRUTH_FILE,
                {
                    "unit": "baseline",
                    "poses": scene.poses,
                    "landmarks": scene.landmarks,
                    "unseen_landmarks": scene.unseen_landmarks,
                    "association": scene.truth.table,
                },
            )
            if self.panoramas:
                self._draw_panoramas(scene, folder / PANORAMAS)
        console.print(f"{path}", soft_wrap=True)

    def _scene(self) -> Scene:
        import numpy as np

        from mht_slam.arrays import finite_number, whole_number
        from mht_slam.models import ObservationModel
        from mht_slam.simulation import Sensor, paper_scene, simulate_pair, simulate_scene

        whole_number(self.seed, "seed", at_least=0)
        finite_number(self.epsilon_deg, "epsilon_deg", at_least=0.0, below=90.0)
        self._refuse_contradictions()
        rng = np.random.default_rng(self.seed)
        spread = math.radians(self.epsilon_deg if self.noise == "uniform" else self._sigma_deg())
        sensor = Sensor(spread=spread, noise=self.noise)
        if self.kind == "paper":
            return paper_scene(rng, spread)
        if self.kind == "model":
            model = ObservationModel(sigma=math.radians(self._sigma_deg()))
            return simulate_scene("model", self.landmarks, rng, model=model, n_scans=self.n_scans)
        if self.pair:
            return simulate_pair(self.kind, self.landmarks, rng, sensor=sensor)
        return simulate_scene(self.kind, self.landmarks, rng, sensor=sensor, n_scans=self.n_scans)

    def _draw_panoramas(self, scene: Scene, folder: Path) -> None:
        """Draw the landmarks in view as cones, in metres, with forward at column 0."""
        import numpy as np

        from mht_slam.simulation.panorama import cones_at, render_panorama
        from mht_slam.simulation.paper_scene import METRES_PER_BASELINE
        from mht_slam.vision.images import write_image

        rng = np.random.default_rng(self.seed)
        cones = cones_at(METRES_PER_BASELINE * scene.landmarks)
        folder.mkdir()
        for index, (x, y, heading) in enumerate(scene.poses.tolist()):
            pose = (METRES_PER_BASELINE * x, METRES_PER_BASELINE * y, heading)
            write_image(folder / f"{index:03d}.png", render_panorama(pose, cones, rng))

    def _sigma_deg(self) -> float:
        return self.epsilon_deg / EPSILON_OVER_SIGMA if self.sigma_deg is None else self.sigma_deg

    def _refuse_contradictions(self) -> None:
        """Refuse options that the kind of scene would silently ignore."""
        if self.kind == "model" and self.noise != "gaussian":
            raise OptionError("noise: kind model has Gaussian noise: give --noise gaussian")
        if self.kind == "paper" and self.noise != "uniform":
            raise OptionError("noise: kind paper has uniform noise: give --noise uniform")
        if self.noise == "uniform" and self.sigma_deg is not None:
            raise OptionError(
                "sigma_deg: uniform noise has a bound: give --epsilon-deg, or --noise gaussian"
            )
        if self.kind == "paper" and self.n_scans != 3:
            raise OptionError("n_scans: kind paper has three scans: leave --n-scans")
        if self.panoramas and self.kind != "paper":
            raise OptionError("panoramas: only kind paper has a length in metres: give it")
        if self.pair and (self.kind in ("model", "paper") or self.n_scans != 3):
            raise OptionError(
                "pair: two runs have four scans and a layout of their own: leave --n-scans, and "
                "give a kind other than model and paper"
            )
