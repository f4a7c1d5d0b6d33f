"""Raviola et al., Robotics 2021, 10, 83: its campaign on simulated arms, beside its printed figures."""
