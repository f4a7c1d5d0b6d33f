"""Drift of friction: one replay's step of the filter, in `step`; its state, its settings, contexts, work on joints, and three rooms. Pure.

update        takes a replay into the filter: innovation, gate, sudden changes and whom to blame for them, the lowest level held
noise         the noise between replays: its size, its tails, and what chance does at every age of a change
channels      wear that F(v*) does not show
"""
