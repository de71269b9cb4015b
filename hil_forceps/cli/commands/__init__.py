"""Commands of hil-forceps, one file each."""
