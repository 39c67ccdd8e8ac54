// Races: two threads of a launch that change one place, and not both by an atomic operation.
//
// Programs are compiled with calls before every access to memory, those of ThreadSanitizer, which are answered here in
// place of its library. Nothing orders the threads of a launch but a collective of their warp or block in between. So
// what happened in one order, without harm, is found as what it is. To write what is there already is allowed: many
// threads set a flag.
#pragma once

#include "failure.h"

#include <cstdint>
#include <cstring>
#include <utility>
#include <vector>

// Who accesses a place, and how many collectives of its warp and its block it has been through.
struct Access {
    uint32_t thread = 0, block = 0, at_warp = 0, at_block = 0;
    bool is_atomic = false;

    bool is_ordered_before(const Access& later) const
    {
        return thread == later.thread || (block == later.block && at_block != later.at_block)
            || (thread / 32 == later.thread / 32 && at_warp != later.at_warp);
    }
};

// The last write to each place in a launch. Places are those of numbers, which are all accessed in one size.
class Writes {
public:
    void clear()
    {
        if (++launch_ == 0 || places_.empty())
            places_.assign(places_.empty() ? 1 << 12 : places_.size(), Place()), launch_ = 1;
        num_used_ = 0;
    }

    // The write to a place in this launch, or where one is to be noted; whether there is one.
    Access& at(uintptr_t address, bool& is_known)
    {
        if (num_used_ == places_.size() / 2)
            grow();
        Place& place = places_[index_of(address)];
        is_known = place.launch == launch_;
        if (!is_known)
            place.address = address, place.launch = launch_, ++num_used_;
        return place.write;
    }

private:
    struct Place {
        uintptr_t address = 0;
        uint32_t launch = 0;
        Access write;
    };

    size_t index_of(uintptr_t address) const
    {
        const size_t mask = places_.size() - 1;
        size_t k = (address * 0x9e3779b97f4a7c15u >> 20) & mask;
        while (places_[k].launch == launch_ && places_[k].address != address)
            k = (k + 1) & mask;
        return k;
    }

    void grow()
    {
        const std::vector<Place> before = std::exchange(places_, std::vector<Place>(2 * places_.size()));
        for (const Place& place : before)
            if (place.launch == launch_)
                places_[index_of(place.address)] = place;
    }

    std::vector<Place> places_;
    uint32_t launch_ = 0;
    size_t num_used_ = 0;
};

// What the threads of a launch do to memory, in the order in which they run.
class Races {
public:
    void begin_launch() { writes_.clear(); }

    // The thread that runs from now on, and its stack.
    void resume(const Access& self, const void* stack, size_t stack_bytes)
    {
        self_ = self;
        stack_ = (uintptr_t)stack;
        stack_bytes_ = stack_bytes;
    }
    // The thread does not run for now: what it was about to write is written.
    void pause()
    {
        if (pending_)
            finish_write();
        stack_ = 0;
        stack_bytes_ = ~(size_t)0;  // no access is one of a thread
    }

    void write(const void* address, size_t size)
    {
        if (pending_ || is_shared((uintptr_t)address))  // most writes are to the stack
            begin_write(address, size);
    }
    void write_atomically(const void* address)
    {
        if (pending_)
            finish_write();
        if (is_shared((uintptr_t)address))
            note((uintptr_t)address, true);
    }

private:
    bool is_shared(uintptr_t address) const { return address - stack_ >= stack_bytes_; }

    [[gnu::noinline]] void begin_write(const void* address, size_t size)
    {
        if (pending_)
            finish_write();
        if (!is_shared((uintptr_t)address) || size > sizeof(before_))
            return;
        pending_ = (const char*)address;
        pending_size_ = size;
        memcpy(before_, address, size);
    }
    // Note a write that has happened since: what it has not changed, it may have left as it was.
    void finish_write()
    {
        const char* address = std::exchange(pending_, nullptr);
        const size_t step = pending_size_ <= 8 ? pending_size_ : 4;
        for (size_t k = 0; k < pending_size_; k += step)
            if (number_at(address + k, step) != number_at(before_ + k, step))
                note((uintptr_t)address + k, false);
    }
    static uint64_t number_at(const char* address, size_t size)
    {
        uint64_t number = 0;
        if (size == 4)  // most are
            memcpy(&number, address, 4);
        else
            memcpy(&number, address, size);
        return number;
    }
    void note(uintptr_t address, bool is_atomic)
    {
        bool is_known;
        Access& last = writes_.at(address, is_known);
        if (is_known && !(last.is_atomic && is_atomic) && !last.is_ordered_before(self_))
            Failure::record("race: thread %u %s what thread %u %s, at %p", self_.thread,
                            is_atomic ? "atomically changes" : "writes", last.thread,
                            last.is_atomic ? "changes atomically" : "writes", (void*)address);
        last = self_;
        last.is_atomic = is_atomic;
    }

    Writes writes_;
    Access self_;
    uintptr_t stack_ = 0;
    size_t stack_bytes_ = ~(size_t)0;
    const char* pending_ = nullptr;
    size_t pending_size_ = 0;
    char before_[256];
};
