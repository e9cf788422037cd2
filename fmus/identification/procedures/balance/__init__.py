"""The balance of momenta of the arm: what `damping` and `inertia` solve."""
