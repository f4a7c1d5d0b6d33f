"""The demo: a simulated UR5, four weeks of its life in two minutes, a joint that wears. It needs no hardware and no network."""
