"""`mht-slam`: choose the command, run it, and turn known errors into one line."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated, TypeAlias

import tyro
from rich.console import Console

from mht_slam import __version__
from mht_slam.cli.bearings import Bearings
from mht_slam.cli.bench import Bench
from mht_slam.cli.convert import Convert
from mht_slam.cli.demo import Demo
from mht_slam.cli.simulate import Simulate
from mht_slam.cli.slam import Slam
from mht_slam.cli.solve import Solve
from mht_slam.cli.track import Track
from mht_slam.errors import MhtSlamError

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141

WIDTH_WITHOUT_TERMINAL = 120
"""Columns of tables that go to a file or a pipe."""

Command: TypeAlias = (
    Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Solve, tyro.conf.subcommand("solve")]
    | Annotated[Slam, tyro.conf.subcommand("slam")]
    | Annotated[Track, tyro.conf.subcommand("track")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate")]
    | Annotated[Convert, tyro.conf.subcommand("convert")]
    | Annotated[Bearings, tyro.conf.subcommand("bearings")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
)

DESCRIPTION = (
    "Mapping and localisation from bearings to landmarks that all look the same. "
    "Angles are degrees. `mht-slam --version` prints the version."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; `argv` without the program's name, None takes the process's own.

    Returns the exit code: 0; 2 for errors, with one line on stderr; 130 when interrupted; 141 when
    the reader of the output has gone. Wrong usage leaves through `SystemExit` with code 2.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        if arguments == ["--version"]:
            sys.stdout.write(f"mht-slam {__version__}\n")
        else:
            _run(arguments)
        # Whoever reads a pipe may have left; better to learn it here than at exit.
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except (MhtSlamError, OSError) as error:
        line = " ".join(str(error).split())
        sys.stderr.write(f"mht-slam: error: {line}\n")
        return EXIT_ERROR
    except KeyboardInterrupt:
        sys.stderr.write("mht-slam: interrupted\n")
        return EXIT_INTERRUPTED
    return 0


def _run(arguments: list[str]) -> None:
    command = tyro.cli(Command, prog="mht-slam", description=DESCRIPTION, args=arguments)
    width = None if sys.stdout.isatty() else WIDTH_WITHOUT_TERMINAL
    command.run(_Console(highlight=False, markup=False, width=width))


class _Console(Console):
    """A console that leaves a broken pipe to `main`; rich would exit on the spot."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError
