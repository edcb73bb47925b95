"""The command line. Commands are modules of this package, which are imported when they are used."""
