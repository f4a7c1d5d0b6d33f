"""Rows of ordinary production → friction: what production tells of each joint's friction, accumulated as sums, and what it cannot tell.

rows → segments (cut out of motion, causes of what is left out) → gather → ProductionInformation (sums, mergeable) → ProductionEstimate.
"""
