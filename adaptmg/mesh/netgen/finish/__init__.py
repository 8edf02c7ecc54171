"""What is made of Netgen's drafts, in arrays: better shapes, and uniform refinement."""
