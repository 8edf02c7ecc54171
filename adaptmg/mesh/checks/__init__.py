"""Is a mesh sound, does a body lie over itself, how well shaped are its elements?"""
