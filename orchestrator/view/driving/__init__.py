"""Two sticks with two axes each: from the hands of a driver to the commands of the machine."""
