"""ROS 2: diagnostics of every arm over Zenoh, as nodes with rmw_zenoh hear them. No ROS has to be installed here."""
