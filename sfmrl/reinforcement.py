"""Reinforcement: deep V-learning, which goes beyond the demonstrations, as in CrowdNav and the paper.

Play with epsilon-greedy lookahead, store each state with the value its episode gives it, learn from random batches.
"""

from collections.abc import Callable, Iterator

from sfmrl.episodes import Record
from sfmrl.exploration import Explored, remember
from sfmrl.learning import Learner


def reinforce(
    learner: Learner, play: Callable[..., Callable[[], Explored]], until: int
) -> Iterator[tuple[Record, float]]:
    """Train up to episode `until`; after each round of episodes, yield their record and the mean loss.

    `play(network, episodes, scenes)` starts to `explore` and returns a function that waits for the result. So a round
    of several episodes can be played on a second process while the batches of the previous round are learnt. Both read
    only what is fixed before they begin, so the numbers do not depend on which ends first.
    """
    settings = learner.config.reinforcement

    def start(first: int) -> Callable[[], Explored]:
        episodes = range(first, min(first + settings.parallel, until))
        return play(learner.actor, episodes, learner.scenes_for(episodes))

    ahead = start(learner.episode)
    while learner.episode < until:
        record, was_random = ahead()  # played epsilon-greedily
        remember(learner, record, was_random)  # state -> value to learn
        learner.renew_actor()
        following = learner.episode + len(record.steps)
        if following < until:
            ahead = start(following)
        loss = learner.learn(len(record.steps) * settings.batches)  # gradient descent
        learner.advance(len(record.steps))  # renew the target network at its interval
        yield record, loss
