"""A UR controller made of software, for the unmodified ur-rtde wheel: its own physics, its own friction, known to no estimator.

The body      physics · friction · wear · thermal, seen through sensors
The mind      controller · program · queries · scripts · reference · motions · kinematics · dashboard: no sockets, no wall clock
The wire      rtde · inputs · variables · primary · realtime as bytes; ports · timer · server put them on a loopback address
The world     scenario · life what happens in the arm's years; faults · arguments what goes wrong on command; settings · launch
The back door commands · remote · stepped · view: for tests, the demo and whoever watches
"""
