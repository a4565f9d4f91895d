"""N2: does the object move, planned or learned from a start without contact?"""
