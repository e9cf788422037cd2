"""The paper's procedures, section 4 (a) to (e) and eqs. (10) to (13), each from one kind of experiment."""
