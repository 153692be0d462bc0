raise ImportError("as in DaXBench, this imports every task and more packages than the bridge's interpreter has")
