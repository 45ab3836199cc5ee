"""Section 2 of the paper: visual order, zones, order changes, and tracks through dense scans."""
