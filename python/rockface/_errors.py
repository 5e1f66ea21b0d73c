"""What goes wrong, by whose fault it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rockface.runs import Run

__all__ = ["FormatError", "PipelineError", "ProgramError", "RockfaceError", "StepError", "StepFailure", "StoreError"]


class RockfaceError(Exception):
    """Anything this package reports."""


class FormatError(RockfaceError):
    """A file is damaged, or of a kind that is not read here."""


class ProgramError(RockfaceError):
    """The program `rockface` is not there, or does not answer as expected."""


class PipelineError(RockfaceError):
    """The pipeline or the command is wrong; the message has every fault with its place."""


class StoreError(RockfaceError):
    """The store or the disk failed, and what was finished is kept; or an output is not there: not kept, or collected."""


@dataclass(frozen=True)
class StepFailure:
    """Why one step instance failed."""

    step: str
    """The instance, such as `dem[epoch=pre]`."""
    stage: str
    """Its stage."""
    message: str
    """The cause."""
    hint: str | None = None
    """The way out, where one is known."""

    def __str__(self) -> str:
        text = f"{self.step} ({self.stage}): {self.message}"
        return f"{text}\n  help: {self.hint}" if self.hint else text


class StepError(RockfaceError):
    """Steps of a run failed; what was finished is kept and is not computed again."""

    def __init__(self, failures: list[StepFailure], run: Run | None = None) -> None:
        super().__init__("\n".join(str(failure) for failure in failures) or "a step failed")
        self.failures = failures
        """One entry for each step that failed."""
        self.run = run
        """The run with what was finished."""

    def __reduce__(self) -> tuple[type[StepError], tuple[list[StepFailure], Run | None]]:
        return type(self), (self.failures, self.run)
