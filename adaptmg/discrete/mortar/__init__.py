"""Contact surfaces of two bodies against each other: dual mortar methods, node-to-node coupling, nodal normals."""
