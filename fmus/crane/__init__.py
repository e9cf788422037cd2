"""Cranes as data: a tree of rigid links (`chain`), and the drives that move its joints (`drives`)."""
