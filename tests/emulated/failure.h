// The error of a launch: recorded where it happens, told to the host, which raises it.
#pragma once

#include <atomic>
#include <cstdarg>
#include <cstdio>
#include <mutex>
#include <string>
#include <utility>

// Thrown to leave a thread of the device at once.
struct ThreadEnded { };

class Failure {
public:
    static bool is_set() { return is_set_; }

    // Keep the first message, and let no further block begin.
    static void record(const char* format, va_list arguments)
    {
        char text[512];
        vsnprintf(text, sizeof(text), format, arguments);
        std::lock_guard<std::mutex> guard(lock_);
        if (!is_set_.exchange(true))
            message_ = text;
    }
    static void record(const char* format, ...)
    {
        va_list arguments;
        va_start(arguments, format);
        record(format, arguments);
        va_end(arguments);
    }

    // The message; launches work again.
    static std::string take()
    {
        std::lock_guard<std::mutex> guard(lock_);
        is_set_ = false;
        return std::exchange(message_, "");
    }

private:
    static inline std::mutex lock_;
    static inline std::string message_;
    static inline std::atomic<bool> is_set_ { false };
};
