"""Notifications: transitions of alerts by mail, webhook or apprise, to whom they concern, and no more often than they can be read."""
