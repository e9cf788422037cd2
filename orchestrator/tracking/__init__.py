"""How well does the tip follow its path?"""
