"""One run of a study file: what it is made of, and what is measured."""
