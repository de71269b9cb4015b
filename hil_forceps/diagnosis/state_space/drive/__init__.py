"""The drive in the filter: its law between two rows, and errors of its command as states.

sample         a sample of the drive: what a count is expected to be, and errors of the law
row            the samples of a row
unseen_counts  what a drive counted between two rows, weighed by the next row's current
between_rows   what that makes of the state, and how it answers to a change of it
"""
