"""What the variants of a system's components cost, alone and in every combination."""
