"""The command line. Commands are modules of this package, imported when they are used."""
