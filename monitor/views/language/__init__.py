"""The languages of page and report: one catalogue a language (gettext), and the forms of dates and figures."""
