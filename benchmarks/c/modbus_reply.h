#ifndef MODBUS_REPLY_H_
#define MODBUS_REPLY_H_

// This is a generated file! Please edit source .ksy file and use kaitai-struct-compiler to rebuild

class modbus_reply_t;

#include "kaitai/kaitaistruct.h"
#include <stdint.h>
#include <vector>

#if KAITAI_STRUCT_VERSION < 11000L
#error "Incompatible Kaitai Struct C++/STL API: version 0.11 or later is required"
#endif

class modbus_reply_t : public kaitai::kstruct {

public:
    class exception_t;
    class registers_t;

    modbus_reply_t(kaitai::kstream* p__io, kaitai::kstruct* p__parent = 0, modbus_reply_t* p__root = 0);

private:
    void _read();
    void _clean_up();

public:
    ~modbus_reply_t();

    class exception_t : public kaitai::kstruct {

    public:

        exception_t(kaitai::kstream* p__io, modbus_reply_t* p__parent = 0, modbus_reply_t* p__root = 0);

    private:
        void _read();
        void _clean_up();

    public:
        ~exception_t();

    private:
        uint8_t m_code;
        modbus_reply_t* m__root;
        modbus_reply_t* m__parent;

    public:
        uint8_t code() const { return m_code; }
        modbus_reply_t* _root() const { return m__root; }
        modbus_reply_t* _parent() const { return m__parent; }
    };

    class registers_t : public kaitai::kstruct {

    public:

        registers_t(kaitai::kstream* p__io, modbus_reply_t* p__parent = 0, modbus_reply_t* p__root = 0);

    private:
        void _read();
        void _clean_up();

    public:
        ~registers_t();

    private:
        uint8_t m_bytes;
        std::vector<uint16_t>* m_values;
        modbus_reply_t* m__root;
        modbus_reply_t* m__parent;

    public:
        uint8_t bytes() const { return m_bytes; }
        std::vector<uint16_t>* values() const { return m_values; }
        modbus_reply_t* _root() const { return m__root; }
        modbus_reply_t* _parent() const { return m__parent; }
    };

private:
    uint8_t m_station;
    uint8_t m_function;
    kaitai::kstruct* m_pdu;
    bool n_pdu;

public:
    bool _is_null_pdu() { pdu(); return n_pdu; };

private:
    uint16_t m_check;
    modbus_reply_t* m__root;
    kaitai::kstruct* m__parent;

public:
    uint8_t station() const { return m_station; }
    uint8_t function() const { return m_function; }
    kaitai::kstruct* pdu() const { return m_pdu; }
    uint16_t check() const { return m_check; }
    modbus_reply_t* _root() const { return m__root; }
    kaitai::kstruct* _parent() const { return m__parent; }
};

#endif  // MODBUS_REPLY_H_
