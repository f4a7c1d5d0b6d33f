"""The demo: one robot, four weeks of its life in two minutes, on one machine without hardware."""
