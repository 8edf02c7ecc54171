"""Meshes that Netgen makes, of plane outlines, solids and STEP files, with the size of elements prescribed."""
