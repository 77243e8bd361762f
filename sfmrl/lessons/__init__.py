"""Teaching aids: explain an episode step by step, verify a run that was handed in, check an installation."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """The result of one check: whether it is as it should be (None: not judged), what was found, and what helps."""

    what: str
    ok: bool | None
    said: str
    remedy: str = ""
