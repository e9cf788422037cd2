"""Two sticks with two axes each: from the driver to the commands of the machine."""
