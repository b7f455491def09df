"""The model: what a definition says, as frozen values with every reference resolved.

Loaders fill it, the checker validates it, compilers and engines read it. It knows no YAML and no file.
"""
