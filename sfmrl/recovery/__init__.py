"""Recovery, an optional aid: lead a robot that makes no progress around the squares, along geodesic distances.

`planner.py` computes how far it is to the goal around the squares; `policy.py` wraps a policy and follows them;
`remembering.py` saves a test with recovery the values that the test without it has computed.
"""

from sfmrl.recovery.planner import Geodesics, plan, solvable
from sfmrl.recovery.policy import RecoveringPolicy, straight_way_is_free, with_recovery

__all__ = ["Geodesics", "RecoveringPolicy", "plan", "solvable", "straight_way_is_free", "with_recovery"]
