"""Control by two sticks: from their deflections in the browser to the commands of the machine."""
