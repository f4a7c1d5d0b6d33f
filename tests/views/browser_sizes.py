"""The windows in which the tests open the page."""

SIZES = {"desktop": {"width": 1366, "height": 900}, "phone": {"width": 390, "height": 844}}  # CSS pixels
