"""Rows of ordinary work → friction: what work tells of each joint's friction, accumulated as sums, and what it cannot tell.

rows → segments (cut out of motion, causes of what is left out) → gather → WorkInformation (sums, mergeable) → WorkEstimate.
"""
