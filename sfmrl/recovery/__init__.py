"""Recovery, an optional aid: lead a robot that makes no progress around the squares, along geodesic distances.

`planner.py` computes the distances to the goal around the squares; `policy.py` wraps a policy and follows them;
`remembering.py` keeps the values that a test without recovery has computed, for the test with it.
"""

from sfmrl.recovery.planner import Geodesics, plan, solvable
from sfmrl.recovery.policy import RecoveringPolicy, with_recovery

__all__ = ["Geodesics", "RecoveringPolicy", "plan", "solvable", "with_recovery"]
