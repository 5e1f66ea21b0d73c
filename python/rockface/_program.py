"""The program `rockface`: where it is, and how it is called."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import NoReturn

from rockface._errors import PipelineError, ProgramError, RockfaceError, StoreError

__all__ = ["call", "environment", "find", "refuse"]

VARIABLE = "ROCKFACE_BIN"
"""The variable of the environment that names the program."""

INTERRUPTED = 130
"""The exit code of a run that was interrupted."""


def find() -> Path:
    """The program: the one `ROCKFACE_BIN` names, the one installed with this package, or the first on the search path.

    Raises:
        ProgramError: there is none.
    """
    named = os.environ.get(VARIABLE)
    if named:
        if not Path(named).is_file():
            raise ProgramError(f"{VARIABLE} names `{named}`, which is no file")
        if not os.access(named, os.X_OK):
            raise ProgramError(f"{VARIABLE} names `{named}`, which is no program that you may run")
        return Path(named)
    schemes = (None, "posix_user")
    folders = [sysconfig.get_path("scripts", scheme) if scheme else sysconfig.get_path("scripts") for scheme in schemes]
    for folder in [*folders, str(Path(sys.executable).parent)]:
        program = Path(folder) / "rockface"
        if program.is_file():
            return program
    found = shutil.which("rockface")
    if found is None:
        raise ProgramError(f"the program `rockface` is not installed: `pip install .` in a clone, or name it in {VARIABLE}")
    return Path(found)


def environment() -> dict[str, str]:
    """The environment of the program: this one, and this Python for steps that are Python functions."""
    return {"ROCKFACE_PYTHON": sys.executable, **os.environ}


def call(*arguments: str, cwd: Path | None = None) -> str:
    """Runs a command of the program to its end; returns what it prints.

    Raises:
        PipelineError: the pipeline or the command is wrong.
        StoreError: the store or the disk failed.
    """
    command = [str(find()), *arguments]
    done = subprocess.run(command, cwd=cwd, env=environment(), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        refuse(done.returncode, done.stderr)
    return done.stdout


def refuse(code: int, stderr: str) -> NoReturn:
    """Raises what an exit code of the program stands for."""
    text = stderr.strip() or f"rockface ended with code {code}"
    if code == INTERRUPTED:
        raise KeyboardInterrupt
    if code == 2:
        raise PipelineError(text)
    if code == 3:
        raise StoreError(text)
    if code < 0:
        raise ProgramError(f"rockface was ended by signal {-code}\n{text}")
    raise RockfaceError(text)
