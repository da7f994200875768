def anatomy():
    return ""
