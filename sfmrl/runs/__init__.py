"""Run folders: what a training writes. It can be killed at any moment and continued to the same bits.

    config.json        every setting                      metrics.csv      a row for each epoch or episode
    run.json           kind, command, versions            validation.csv   success rates during the training
    checkpoint-N.npz   everything that resuming needs     weights.npz      the trained network, at the end
    demonstrations.npz ORCA's, for imitation learning     best.npz         the network of the best validation
    map.txt            the map, if it trains on one       test.csv         a row for each episode of the final test
    SHA256SUMS         a digest of each file              result.json      metrics of the final test

Files are written whole or not at all, and their digests enter SHA256SUMS with them; those of the tables, which grow
during the training, enter at its end. A continued run starts from its newest checkpoint.

`files` writes and checks files. `folders` lists runs, `run` opens one, `create` makes one. `weights` and `crowdnav`
read and write networks, `demonstrations` trajectories. `training` runs the algorithms, `explorer` plays their episodes
on a second process, `progress` reports on them, `bits` says which versions and bits a run was made with.
This module imports nothing, so that `sfmrl --help` and shell completion do without NumPy.
"""
