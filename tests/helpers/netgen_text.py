"""A small mesh as Netgen writes it, to be read and to be damaged: two triangles."""

__all__ = ["VOL"]

# as written by Netgen before 2025: twelve columns, the first the number of the boundary
VOL = """mesh3d
dimension
2
geomtype
0
surfaceelements
2
 1 1 1 0 3 1 2 3
 1 1 1 0 3 1 3 4
volumeelements
0
edgesegmentsgi2
4
 1 0 1 2 -1 -1 1 0 1 0 1 1
 2 0 2 3 -1 -1 1 0 2 0 2 1
 3 0 3 4 -1 -1 1 0 3 0 3 1
 1 0 4 1 -1 -1 1 0 4 0 4 1
points
4
 0 0 0
 2 0 0
 2 1 0
 0 1 0
materials
1
1 steel
bcnames
3
1 side
2 right
3 top
endmesh
"""
