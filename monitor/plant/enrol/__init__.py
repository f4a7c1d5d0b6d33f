"""Enrolment: from a list of arms to the configurations, certificates and access control of a plant, as files in one folder."""
