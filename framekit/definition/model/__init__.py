"""The model: the content of a definition, as frozen values with every reference resolved.

Loaders fill it, the checker validates it, compilers and engines read it. It depends on neither YAML nor files.
"""
