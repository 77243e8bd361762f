"""Teaching aids: explain an episode step by step, verify a run that was handed in, check an installation."""
