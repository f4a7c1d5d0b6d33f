"""Motions and torques → parameters: equations of motion, least squares, friction laws, physical consistency, covariances."""
