"""Reinforcement: deep V-learning from the robot's own episodes, as in CrowdNav and the paper.

Play with epsilon-greedy lookahead, store each state with its value to learn, and learn from random batches.
"""

from collections.abc import Callable, Iterator

from sfmrl.episodes import Record
from sfmrl.exploration import Explored, remember
from sfmrl.learning import Learner


def reinforce(
    learner: Learner, start_exploring: Callable[..., Callable[[], Explored]], until: int
) -> Iterator[tuple[Record, float]]:
    """Train up to episode `until`; after each round of episodes, yield their record and the mean loss.

    `start_exploring(network, episodes)` starts to `explore` and returns a function that waits for the result. A round
    of several episodes can be played by a second process while the network learns from the batches of the previous
    round: it is played with a copy of the network, the actor, so the numbers do not depend on which ends first. A round
    of one episode is played when the returned function is called, with the network as it is then.
    """
    settings = learner.config.reinforcement

    def start_round(first: int) -> Callable[[], Explored]:
        return start_exploring(learner.actor, range(first, min(first + settings.parallel, until)))

    finish_round = start_round(learner.episode)
    while learner.episode < until:
        record, was_random = finish_round()  # played epsilon-greedily
        remember(learner, record, was_random)  # store each state with its value to learn
        learner.renew_actor()  # here, so that the next round can start before the learning does
        following = learner.episode + len(record.steps)
        if following < until:
            finish_round = start_round(following)
        loss = learner.learn(len(record.steps) * settings.batches)  # gradient descent
        learner.advance(len(record.steps))  # renew the target network at its interval
        yield record, loss
