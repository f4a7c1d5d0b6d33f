"""The campaign of Raviola et al., Robotics 2021, 10, 83 on simulated arms, compared with the figures that the paper prints."""
