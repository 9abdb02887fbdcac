"""Whether a value is to be trusted: a code that programs branch on, and the sentence that people
read."""

from __future__ import annotations

from enum import StrEnum


class StatusCode(StrEnum):
    """What is wrong. The first stage that says so decides; later ones hand it on."""

    OK = "ok"
    NO_IMAGE = "no image"  # the camera is blind, late or stale
    PERCEPTION_TIMEOUT = "no answer"  # what looks at the images does not answer, or failed
    TOO_FEW_MARKERS = "too few markers"
    FIT_FAILED = "no shape"  # the markers fit no shape that the membrane can have
    OVERLOADED = "overloaded"  # and did not since they showed a large force
    # the rest is not what it was: temperature, a camera that moved
    REFERENCE_LOST = "reference lost"
    PRESSURE_CHANGING = "air moves"  # the chamber's pressure changes too fast to be followed
    FORCE_TOO_LOW = "too weak"  # too small a force to say it by
    INCOMPLETE_DATA = "too little seen"  # the probe was not finished
    AMBIGUOUS = "undecided"  # the evidence fits two answers
    NOT_ESTIMATED = "not estimated"  # this method does not tell
    OTHER = "other"  # a text without a code: an older recording, a user's own


class Status(str):
    """`"ok"`, or a short reason why a value should not be trusted; `code` is the same for programs.

    It is text, so that `status == "ok"`, arrays of statuses and recordings (which hold the text)
    need no conversion, and a message may carry numbers. "unknown" is an answer; zero is not.
    """

    __slots__ = ("code",)
    code: StatusCode

    def __new__(cls, code: StatusCode, message: str = "") -> Status:
        self = super().__new__(cls, message or code.value)
        self.code = code
        return self

    @classmethod
    def of(cls, text: str) -> Status:
        """`text` itself where it is a status; else "ok" or OTHER by what it says."""
        if isinstance(text, cls):
            return text
        return cls(StatusCode.OK if text == StatusCode.OK else StatusCode.OTHER, text)

    def __reduce__(self) -> tuple[type[Status], tuple[StatusCode, str]]:
        return Status, (self.code, str(self))


OK = Status(StatusCode.OK)
