"""Arguments of the command line, read and checked: options, lines to a drive, files, folders, answers."""
