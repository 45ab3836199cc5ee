"""The paper's section 3: cones, cells, the landmark frame, intersection ratios, rankings."""
