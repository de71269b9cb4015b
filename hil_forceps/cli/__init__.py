"""Arguments and wiring of the hil-forceps command."""
