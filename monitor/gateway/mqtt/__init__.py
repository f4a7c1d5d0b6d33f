"""MQTT: the newest state of each arm as retained messages, and Home Assistant's discovery of them."""
