"""`mht-slam demo`: the paper's scene, from bearings to compared hypotheses."""

from __future__ import annotations

from dataclasses import dataclass, field

from rich.console import Console

from mht_slam.cli.options import Method, MethodOptions, Output, OutputOptions, Work, WorkOptions
from mht_slam.cli.run_folder import to_json

SCANS = (0, 1, 2)


@dataclass(frozen=True)
class Demo:
    """Run the whole method on a simulation of the paper's experiment.

    Three scans of three look-alike landmarks, noise uniform inside epsilon. Prints one table of
    hypotheses with the truth marked, and leaves results and figures in a stamped folder.
    """

    seed: int = 0
    """Seed of the noise and of the order of detections."""
    method: Method = field(default_factory=MethodOptions)
    work: Work = field(default_factory=WorkOptions)
    output: Output = field(default_factory=OutputOptions)

    def run(self, console: Console) -> None:
        """Simulate the scene and solve it."""
        import numpy as np

        from mht_slam.arrays import whole_number
        from mht_slam.cli.study import Study, run_study
        from mht_slam.plotting import TrueLayout
        from mht_slam.simulation import paper_scene

        whole_number(self.seed, "seed", at_least=0)
        self.method.model()  # says what is wrong with it before anything is printed
        self.work.check()
        scene = paper_scene(np.random.default_rng(self.seed), self.method.epsilon)
        study = Study(
            command="demo",
            run=scene.run,
            scans=SCANS,
            truth=scene.truth,
            layout=TrueLayout(scene.poses, scene.landmarks, scene.truth),
            configuration={"seed": self.seed, "options": to_json(self)},
        )
        console.print(
            f"The paper's scene: three scans of three landmarks, noise uniform inside "
            f"{self.method.epsilon_deg:g} deg, seed {self.seed}."
        )
        run_study(study, self.method, self.work, self.output, console)
