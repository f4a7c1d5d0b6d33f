"""One Bayesian model of a joint's friction over the replays: what it consists of, kinds of noise, changes, decision, posterior."""
