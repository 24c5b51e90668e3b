"""What can be wrong with an input, as exceptions that say what, the measured value, and what to try."""

from __future__ import annotations

from typing import ClassVar


class DualMSError(Exception):
    """A design cannot go on, for a reason that is safe to show to whoever asked for it.

    Parameters
    ----------
    message
        What is wrong, with the measured value and where.
    advice
        What to try.
    measured
        The figures behind the message, as JSON scalars or lists, for programs.
    """

    code: ClassVar[str] = "design-failed"

    def __init__(self, message: str, *, advice: str = "", measured: dict[str, object] | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.advice = advice
        self.measured = dict(measured or {})

    def __str__(self) -> str:
        return f"{self.message} {self.advice}".strip()


class InvalidMesh(DualMSError):
    """The file is not a closed, oriented, single body that can be an envelope."""

    code = "invalid-mesh"


class UnreadableFile(InvalidMesh):
    """The bytes are not a mesh in the format that the file claims."""

    code = "unreadable-file"


class UnsupportedFormat(InvalidMesh):
    """The file's format is none that DualMS reads."""

    code = "unsupported-format"


class MissingUnits(DualMSError):
    """The format carries no length unit and the request names none."""

    code = "missing-units"


class TooLarge(DualMSError):
    """The input exceeds a stated limit (bytes, faces, memory or time)."""

    code = "too-large"


class InvalidSpec(DualMSError):
    """Values of the specification contradict each other or the domain."""

    code = "invalid-spec"


class PortNotOnBoundary(DualMSError):
    """A port does not touch the domain's boundary."""

    code = "port-not-on-boundary"


class OverlappingPorts(DualMSError):
    """Two ports cover the same part of the boundary and are not declared as shared."""

    code = "overlapping-ports"


class DisconnectedDomain(DualMSError):
    """At the asked resolution the domain falls into parts, or a fluid's ports lie in different parts."""

    code = "disconnected-domain"


class InfeasiblePartition(DualMSError):
    """No partition of the sites keeps both fluids connected with their ports."""

    code = "infeasible-partition"


class FieldDiverged(DualMSError):
    """The field's solver produced values that are not finite."""

    code = "field-diverged"


class EmptySurface(DualMSError):
    """The zero level set misses the domain: one fluid fills it all."""

    code = "empty-surface"


class WallTooThick(DualMSError):
    """The wall or shell leaves no room for a fluid."""

    code = "wall-too-thick"


class ChannelBlocked(DualMSError):
    """A fluid's channel does not lead from its inlets to its outlets."""

    code = "channel-blocked"


class InvalidBody(DualMSError):
    """The boolean operations did not give closed solids."""

    code = "invalid-body"


class EvaluationUnavailable(DualMSError):
    """A flow evaluation was asked for where no solver can run it."""

    code = "evaluation-unavailable"


class EvaluationFailed(DualMSError):
    """The flow solver did not give a usable result."""

    code = "evaluation-failed"
