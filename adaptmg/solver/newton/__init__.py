"""The semismooth Newton method: the contact conditions linearised, and how its steps are solved."""
