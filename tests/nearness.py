"""Is printed output what a page shows, on a machine that computes other bits: the same words, and near numbers.

Four of five lines must have the same words. In these, of two values with intervals beside or below them one must lie in
the other's interval; losses and times in tables may differ by 5 %, rates (.010) by 0.03, other fractions by a quarter,
counts by three or a quarter. Of a drawing, four of five signs must be the same.
"""

import math
import re
from difflib import SequenceMatcher

LINES, FINE, COARSE = 0.8, 0.05, 0.25
FEW = {"rate": 0.03, "fraction": 0.002, "count": 3.0}  # differences that are always near
NUMBER = r"[-+]?\d*\.?\d+"
BOUNDS = rf"({NUMBER})(?:-| to )({NUMBER})"
VALUE = re.compile(rf"(?<![\w.])({NUMBER})(?: +\(?{BOUNDS}\)?)?( s\b)?")  # 0.99 0.95-1.00, .01 (-.02 to .03), 9.5 s


def near(shown: str, printed: str) -> bool:
    """Whether `printed` is near to what is `shown`."""
    if "╭─" in shown:
        return _drawn_alike(shown, printed)
    one, other = _lines(shown), _lines(printed)
    words = [[re.sub(r"[ ─━═]+", "", VALUE.sub("\0", line)) for line in lines] for lines in (one, other)]
    blocks = SequenceMatcher(None, *words, autojunk=False).get_matching_blocks()
    pairs = [(one[i + k], other[j + k]) for i, j, count in blocks for k in range(count)]
    return len(pairs) >= math.ceil(LINES * max(len(one), len(other))) and all(
        one == other or _near(one, other) for one, other in pairs
    )


def _lines(text: str) -> list[str]:
    """A text's lines; the intervals below a table's row are put beside its numbers."""
    found: list[str] = []
    for line in text.rstrip().splitlines():
        cells = line.split("│")
        if found and any(re.fullmatch(BOUNDS, cell.strip()) for cell in cells):
            found[-1] = "│".join(map(" ".join, zip(found[-1].split("│"), cells, strict=True)))
        else:
            found.append(line.rstrip())
    return found


def _near(shown: str, printed: str) -> bool:
    pairs = zip(VALUE.finditer(shown), VALUE.finditer(printed), strict=True)
    return all(_numbers_near(one, other, "│" in shown) for one, other in pairs)


def _numbers_near(shown: re.Match, printed: re.Match, in_table: bool) -> bool:
    one, other = float(shown[1]), float(printed[1])
    if shown[2] and printed[2]:
        return _within(other, shown) or _within(one, printed)
    decimals = len(shown[1].partition(".")[2])
    fine = decimals > 6 or (in_table and shown[4])  # a loss, or a time
    if fine:
        return abs(one - other) <= FINE * abs(one)
    kind = "rate" if shown[1].startswith(".") else "fraction" if decimals else "count"
    return abs(one - other) <= max(COARSE * max(abs(one), abs(other)), FEW[kind], 10.0**-decimals)


def _within(value: float, interval: re.Match) -> bool:
    rounding = 0.5 * 10.0 ** -len(interval[2].partition(".")[2])
    return float(interval[2]) - rounding <= value <= float(interval[3]) + rounding


def _drawn_alike(shown: str, printed: str) -> bool:
    one, other = ("".join(line.ljust(200) for line in text.rstrip().splitlines()) for text in (shown, printed))
    equal = [a == b for a, b in zip(one, other, strict=False) if (a, b) != (" ", " ")]
    return len(one) == len(other) and sum(equal) >= LINES * len(equal)
