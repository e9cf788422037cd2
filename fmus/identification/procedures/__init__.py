"""The paper's identification procedures, section 4 (a) to (e) and eqs. (10) to (13), one per experiment."""
